# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Planes against a sensor's depth, from planes to depth and from labelled depth to planes."""

import numpy as np
import pytest

from plane_detector.evaluation.reference_planes import fit_planes, judge_planes, plane_depth
from plane_detector.evaluation.scenes.rooms import random_room
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)


def test_a_plane_is_judged_by_hand():
    """Of a predicted plane at 2.1 m, three quarters lie on a wall at 2 m, the rest is further."""
    sensor_m = np.full((120, 160), 2.0)
    sensor_m[:, 120:] = 3.0
    labels = np.zeros(sensor_m.shape, np.int32)
    tilted = np.radians(10)
    planes = np.array([[0, np.sin(tilted), -np.cos(tilted), 2.1]])
    (judged,) = judge_planes(labels, planes, sensor_m, CAMERA, np.random.default_rng(0))
    assert judged.pixels == sensor_m.size
    assert judged.purity == pytest.approx(0.75)
    assert judged.normal_error_deg == pytest.approx(10, abs=0.1)
    assert judged.offset_error_m == pytest.approx(0.1, abs=1e-3)


@pytest.mark.parametrize(('distance_m', 'stray_m', 'purity'), [
    (1.0, 0.029, 1), (1.0, 0.04, 7 / 8), (4.0, 0.057, 1), (4.0, 0.075, 7 / 8)])
def test_the_tolerance_is_3_cm_or_a_share_of_the_depth(distance_m, stray_m, purity):
    sensor_m = np.full((120, 160), distance_m, np.float32)
    sensor_m[:, ::16] += stray_m
    sensor_m[:, 8::16] -= stray_m
    (judged,) = judge_planes(np.zeros(sensor_m.shape, int), np.array([[0, 0, -1, distance_m]]),
                             sensor_m, CAMERA, np.random.default_rng(0))
    assert judged.purity == pytest.approx(purity)


def test_the_depth_of_a_plane_is_where_the_rays_meet_it():
    scene = random_room(np.random.default_rng(2), CAMERA)
    np.testing.assert_allclose(plane_depth(scene.labels, scene.planes, CAMERA), scene.depth_m,
                               rtol=1e-4)
    nothing = np.full((120, 160), -1)
    assert np.isnan(plane_depth(nothing, scene.planes[:0], CAMERA)).all()


def test_planes_are_fitted_to_their_pixels():
    scene = random_room(np.random.default_rng(2), CAMERA)
    np.testing.assert_allclose(fit_planes(scene.labels, scene.depth_m, CAMERA), scene.planes,
                               atol=2e-3)
