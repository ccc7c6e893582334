# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of the choice of the direction of gravity."""

import numpy as np
import pytest

from plane_detector.directions.finder import choose_gravity
from plane_detector.directions.vanishing import NO_PAIRS, SceneDirections

NONE = (0.0, 0.0, 0.0)
GIVEN = (0.0, 2.0, 0.0)
IMU = np.array([0.0, 0.8, 0.6])


def of_image(angle_deg=0.0, refusal=''):
    angle = np.radians(angle_deg)
    down = None if refusal else np.array([0.0, np.cos(angle), np.sin(angle)])
    return SceneDirections(down, np.radians(1.5) ** 2 * np.diag([1.0, 0, 1]), NO_PAIRS, refusal)


def test_a_sensor_comes_before_the_parameter_and_that_before_the_image():
    assert choose_gravity(IMU, GIVEN, 2.0, of_image()).source == 'measured'
    given = choose_gravity(None, GIVEN, 2.0, of_image(30))
    assert given.source == 'parameter'
    assert given.gravity_camera == pytest.approx([0, 1, 0])
    assert choose_gravity(None, NONE, 2.0, of_image()).source == 'image'


def test_the_tolerance_of_the_image_is_by_its_covariance():
    assert choose_gravity(None, NONE, 10.0, of_image()).tolerance_deg == pytest.approx(3.0)


@pytest.mark.parametrize(('angle_deg', 'source'), [(12, 'image'), (25, 'parameter')])
def test_a_coarse_direction_is_replaced_by_that_of_an_agreeing_image(angle_deg, source):
    assert choose_gravity(None, GIVEN, 15.0, of_image(angle_deg)).source == source


@pytest.mark.parametrize(('tolerance_deg', 'is_sure'), [(5.0, True), (5.5, False)])
def test_a_direction_is_sure_if_planes_can_be_classified_by_it(tolerance_deg, is_sure):
    assert choose_gravity(IMU, NONE, tolerance_deg, None).is_sure == is_sure
    assert not choose_gravity(None, NONE, tolerance_deg, None).is_sure


def test_the_reason_for_unknown_gravity_is_given():
    found = choose_gravity(None, NONE, 2.0, of_image(refusal='only 3 straight lines'))
    assert (found.gravity_camera, found.source, found.note) == (None, 'none',
                                                             'only 3 straight lines')
    assert choose_gravity(None, NONE, 2.0, None).note == ''
