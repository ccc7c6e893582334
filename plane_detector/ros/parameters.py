# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The settings as ROS parameters: one parameter per field, declared and checked by a loop.

A nested dataclass becomes a prefix: ``depth.model``. Nothing is named here twice; name, type,
default, range and description all come from the fields.
"""

from __future__ import annotations

import array
from collections.abc import Iterable
from dataclasses import Field, fields, replace
from difflib import get_close_matches
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from plane_detector.settings import Settings, parameters_of

AnySettings = TypeVar('AnySettings', bound=Settings)
_LARGEST = 1.7e308


def declare(node: Node, defaults: AnySettings) -> AnySettings:
    """
    Declare every field as a parameter, and return the settings with their initial values.

    Raises
    ------
    ValueError
        An initial value is out of range.
    rclpy.exceptions.ParameterException
        An initial value has another type.

    """
    values = [node.declare_parameter(name, list(value) if isinstance(value, tuple) else value,
                                     descriptor(field, value))
              for name, field, value in parameters_of(defaults)]
    return updated(defaults, values)


def warn_of_unknown(node: Node) -> None:
    """
    Log which initial values are of no declared parameter, each with the nearest one there is.

    Values of quality of service are left out: they are declared with their topics, later.
    """
    declared = node.list_parameters([], 0).names
    given = node._parameter_overrides  # for these rclpy has no public name
    unknown = sorted(name for name in given
                     if name not in declared and not name.startswith('qos_overrides.'))
    told = [name + ''.join(f' (meant: {near}?)' for near in get_close_matches(name, declared, 1))
            for name in unknown]
    if told:
        node.get_logger().warning(
            f'ignored, because no parameter has this name: {", ".join(told)}')


def updated(settings: AnySettings, parameters: Iterable[Parameter]) -> AnySettings:
    """
    Return settings with the values of those parameters that are theirs; others are left out.

    Raises
    ------
    ValueError
        A value is out of range, or does not go with another one.

    """
    values = {parameter.name: parameter.value for parameter in parameters}
    return _replaced(settings, values, '')


def descriptor(field: Field, default: Any) -> ParameterDescriptor:
    """Return what `ros2 param describe` shows: description, unit, range, choices."""
    meta = field.metadata
    unit = f' [{meta["unit"]}]' if meta['unit'] else ''
    result = ParameterDescriptor(description=meta['doc'] + unit, read_only=meta['read_only'])
    result.additional_constraints = _constraints(meta)
    result.dynamic_typing = _is_switch(meta)
    low, high = meta['low'], meta['high']
    if low is None and high is None:
        return result
    if isinstance(default, float):
        result.floating_point_range = [FloatingPointRange(
            from_value=float(-_LARGEST if low is None else low),
            to_value=float(_LARGEST if high is None else high))]
    elif isinstance(default, int):
        result.integer_range = [IntegerRange(
            from_value=int(-2**63 if low is None else low),
            to_value=int(2**63 - 1 if high is None else high))]
    return result


def _constraints(meta: Any) -> str:
    """Return in words what a range of the descriptor cannot say: choices, limits of arrays."""
    if meta['choices']:
        return 'one of ' + ', '.join(meta['choices'])
    limits = [f'at least {meta["low"]:g}' if meta['low'] is not None else '',
              f'at most {meta["high"]:g}' if meta['high'] is not None else '']
    return ', '.join(limit for limit in limits if limit)


def _is_switch(meta: Any) -> bool:
    """Whether true and false are among the choices: yaml files give them as bool."""
    return 'true' in meta['choices']


def _field_value(field: Field, value: Any) -> Any:
    if isinstance(value, bool) and _is_switch(field.metadata):
        return str(value).lower()
    return tuple(value) if isinstance(value, (list, array.array)) else value


def _replaced(settings: AnySettings, values: dict[str, Any], prefix: str) -> AnySettings:
    changes = {}
    for field in fields(settings):
        name, old = prefix + field.name, getattr(settings, field.name)
        if isinstance(old, Settings):
            changes[field.name] = _replaced(old, values, f'{name}.')
        elif name in values:
            changes[field.name] = _field_value(field, values[name])
    return replace(settings, **changes)
