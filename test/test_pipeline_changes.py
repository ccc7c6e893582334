# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Settings that may change while a detector runs are read from its ``config`` alone."""

from dataclasses import fields, replace

import numpy as np
import pytest

from plane_detector.config import Config
from plane_detector.pipeline import PlaneDetector
from plane_detector.settings import Settings

# Valid values of settings whose type and range say too little.
VALUES = {'scale.gravity': (0.0, 1.0, 0.0), 'shapes.types': 'sphere',
          'scale.imu_to_camera': (1.0, 0.0, 0.0, 0.0)}


def depth_of(rgb):
    return np.full(rgb.shape[:2], 2.0)


def live_settings():
    for section in fields(Config):
        settings = getattr(Config(), section.name)
        for field in fields(settings) if isinstance(settings, Settings) else ():
            if not field.metadata['read_only']:
                yield section.name, field


def other_value(name, field):
    value, meta = field.default, field.metadata
    if name in VALUES:
        return VALUES[name]
    if isinstance(value, bool):
        return not value
    if meta['choices']:
        return next(choice for choice in meta['choices'] if choice != value)
    candidates = (type(value)(one) for one in (value + 1, value / 2, meta['high'], meta['low']))
    return next(one for one in candidates if one != value and meta['low'] <= one <= meta['high'])


def state_of(thing):
    """Return what an object of this package holds, and what its parts hold."""
    if not type(thing).__module__.startswith('plane_detector') or not hasattr(thing, '__dict__'):
        return repr(thing)
    return {name: state_of(part) for name, part in vars(thing).items()}


@pytest.mark.parametrize(('section', 'field'), list(live_settings()),
                         ids=lambda one: getattr(one, 'name', one))
def test_no_part_of_a_detector_keeps_a_setting_that_may_change(section, field):
    settings = replace(getattr(Config(), section),
                       **{field.name: other_value(f'{section}.{field.name}', field)})
    default = state_of(PlaneDetector(Config(), depth_of))
    changed = state_of(PlaneDetector(Config(**{section: settings}), depth_of))
    assert changed.pop('config') != default.pop('config')
    assert changed == default
