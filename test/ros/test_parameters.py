# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The settings as ROS parameters: declared, described, read and changed."""

import re
from contextlib import ExitStack
from dataclasses import dataclass, field

import pytest
from rcl_interfaces.msg import ParameterType
from rclpy.parameter import Parameter
from ros_helpers import bare_node

from plane_detector.ros import parameters
from plane_detector.settings import Settings, fixed_setting, setting


@dataclass(frozen=True)
class Inner(Settings):
    count: int = fixed_setting(3, 'how many', 'px', 0, 10)
    names: tuple[str, ...] = setting(('a', 'b'), 'which')


@dataclass(frozen=True)
class Outer(Settings):
    inner: Inner = field(default_factory=Inner)
    gain: float = setting(0.5, 'how much', 'm', 0.0, None)
    weights: tuple[float, ...] = setting((1.0, 2.0), 'weights', low=0.5)
    switch: str = setting('auto', 'whether', choices=('auto', 'true', 'false'))


@pytest.fixture
def make_node():
    with ExitStack() as opened:
        yield lambda **values: opened.enter_context(bare_node('settings', parameter_overrides=[
            Parameter(name.replace('__', '.'), value=value) for name, value in values.items()]))


def test_overrides_reach_the_fields(make_node):
    node = make_node(inner__count=7, inner__names=['x'], gain=2.5, weights=[3.0])
    assert parameters.declare(node, Outer()) == Outer(Inner(7, ('x',)), 2.5, (3.0,))


@pytest.mark.parametrize('overrides, message', [
    ({'inner__count': 11}, 'inner.count must be a whole number, at least 0, at most 10, not 11'),
    ({'inner__count': 1.5}, 'inner.count must be a whole number, at least 0, at most 10, not 1.5'),
    ({'gain': -0.1}, 'gain must be a number, at least 0, not -0.1'),
    ({'gain': -1}, 'gain must be a number, at least 0, not -1'),
    ({'gain': True}, 'gain must be a number, at least 0, not True'),
    ({'gain': [1]}, 'gain must be a number, at least 0, not '),
    ({'inner__names': 'x'}, "inner.names must be a list, each a text, not 'x'"),
    ({'weights': [0.1]}, 'weights'),
    ({'switch': 'maybe'}, 'switch must be one of')])
def test_impossible_overrides_are_refused_with_name_and_remedy(make_node, overrides, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        parameters.declare(make_node(**overrides), Outer())


def test_integers_are_accepted_for_floats(make_node):
    node = make_node(gain=2, weights=[1, 3])
    assert parameters.declare(node, Outer()) == Outer(gain=2.0, weights=(1.0, 3.0))
    assert node.get_parameter('gain').type_ == Parameter.Type.DOUBLE
    assert node.get_parameter('weights').type_ == Parameter.Type.DOUBLE_ARRAY
    changed = parameters.with_floats(Outer(), [
        Parameter('gain', value=3), Parameter('weights', value=[4, 5]),
        Parameter('inner.count', value=6), Parameter('other', value=7)])
    assert [(p.name, p.value, type(p.value)) for p in changed if p.name != 'weights'] == [
        ('gain', 3.0, float), ('inner.count', 6, int), ('other', 7, int)]
    assert list(changed[1].value) == [4.0, 5.0]
    settings = parameters.updated(Outer(), [Parameter('gain', value=3)])
    assert isinstance(settings.gain, float)


def warnings_of(node, monkeypatch):
    warnings = []
    monkeypatch.setattr(node.get_logger(), 'warning', warnings.append)
    parameters.warn_of_unknown(node)
    return warnings


def test_unknown_names_are_reported_with_the_most_similar(make_node, monkeypatch):
    node = make_node(inner__cuont=7, gain=2.5, count=1, zzz='?')
    parameters.declare(node, Outer())
    (warnings,) = warnings_of(node, monkeypatch)
    assert warnings.endswith('count (meant: inner.count?), inner.cuont (meant: inner.count?), zzz')


def test_descriptors_have_unit_range_and_choices(make_node):
    node = make_node()
    parameters.declare(node, Outer())
    count = node.describe_parameter('inner.count')
    assert count.type == ParameterType.PARAMETER_INTEGER
    assert count.description == 'how many [px]; read when the node is configured'
    assert (count.integer_range[0].from_value, count.integer_range[0].to_value) == (0, 10)
    gain = node.describe_parameter('gain')
    assert gain.floating_point_range[0].from_value == 0.0
    assert gain.floating_point_range[0].to_value > 1e300
    assert gain.description == 'how much [m]'
    assert node.describe_parameter('weights').additional_constraints == 'at least 0.5'
    assert node.describe_parameter('switch').additional_constraints == 'one of auto, true, false'


def test_updating_leaves_others_and_the_old_settings_alone():
    old = Outer()
    changed = [Parameter('inner.count', value=4), Parameter('use_sim_time', value=True)]
    assert parameters.updated(old, changed) == Outer(Inner(count=4))
    assert old == Outer()
