# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""True planes from annotated instances and measured depth."""

import numpy as np
import pytest

from plane_detector.evaluation.annotated_planes import MIN_PIXELS, annotated_planes
from plane_detector.evaluation.scenes.rooms import random_room, single_wall
from plane_detector.types import CameraIntrinsics

SMALL = CameraIntrinsics(262.5, 262.5, 159.5, 119.5, 320, 240)
WALL = single_wall(SMALL, yaw_deg=0, distance_m=2.0)


def planes_of(segments, depth_m):
    return annotated_planes(segments, depth_m, SMALL, np.random.default_rng(0))


def test_each_instance_of_a_room_is_its_plane():
    scene = random_room(np.random.default_rng(3), SMALL)
    labels, planes = planes_of(scene.labels + 1, scene.depth_m)
    for k, plane in enumerate(planes):
        true, pixels = np.unique(scene.labels[labels == k], return_counts=True)
        assert len(true) == 1
        assert pixels[0] >= 0.999 * np.count_nonzero(scene.labels == true[0])
        np.testing.assert_allclose(plane, scene.planes[true[0]], atol=1e-3)
    large = np.bincount(scene.labels[scene.labels >= 0]) >= MIN_PIXELS
    assert len(planes) == np.count_nonzero(large) > 2


def test_an_instance_with_two_faces_has_two_planes():
    scene = random_room(np.random.default_rng(3), SMALL)
    largest = np.argsort(np.bincount(scene.labels[scene.labels >= 0]))[-2:]
    both = np.isin(scene.labels, largest).astype(int)
    labels, planes = planes_of(both, scene.depth_m)
    assert len(planes) == 2
    assert np.mean(labels[both == 1] >= 0) > 0.999
    assert (labels[both == 0] == -1).all()


@pytest.mark.parametrize(('noise_m', 'share'), [(0.01, 0.99), (0.1, 0.5)])
def test_pixels_beyond_the_tolerance_are_left_out(noise_m, share):
    depth_m = WALL.depth_m + np.random.default_rng(0).normal(0, noise_m, WALL.depth_m.shape)
    labels, _ = planes_of(np.ones(depth_m.shape, int), depth_m.astype(np.float32))
    found = np.mean(labels == 0)
    assert found > share if share > 0.9 else found < share
