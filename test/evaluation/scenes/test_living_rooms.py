# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The ground truth of rendered living rooms is correct, and their furniture as stated."""

from functools import cache

import numpy as np
import pytest

from plane_detector.evaluation.scenes.living_rooms import living_room
from plane_detector.evaluation.scenes.rendering import camera_rotation, render
from plane_detector.evaluation.scenes.surfaces import (
    block,
    ellipsoid,
    joined,
)
from plane_detector.geometry.projection import depth_to_points
from plane_detector.types import CameraIntrinsics

SMALL = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)
MEDIUM = CameraIntrinsics(262.0, 262.0, 159.5, 119.5, 320, 240)
SEEDS = range(2)


@cache
def room(seed):
    return living_room(np.random.default_rng(seed), MEDIUM)


def seen(thing, position=(0, -3, 0), intrinsics=SMALL, yaw_deg=0.0):
    """Return the image of a thing seen by a horizontal camera that looks along y."""
    return render(thing.flat, camera_rotation(yaw_deg, 0, 0), np.array(position, float),
                  intrinsics, np.random.default_rng(0), thing.curved_pieces())


def world_points(scene, position=(0, -3, 0)):
    """Return the points of the valid pixels in the world, for the camera of `seen`."""
    points_m = depth_to_points(scene.depth_m, SMALL)[np.isfinite(scene.depth_m)]
    return points_m @ camera_rotation(0, 0, 0).T + np.array(position)


@pytest.mark.parametrize('seed', SEEDS)
def test_points_lie_on_the_planes_of_their_labels(seed):
    scene = room(seed)
    points_m = depth_to_points(scene.depth_m, scene.intrinsics)
    labelled = scene.labels >= 0
    assert np.isfinite(scene.depth_m[labelled]).all()
    planes = scene.planes[scene.labels[labelled]]
    distance_m = (points_m[labelled] * planes[:, :3]).sum(1) + planes[:, 3]
    assert (np.abs(distance_m) < 1e-5 * points_m[labelled][:, 2]).all()


def test_a_ball_has_its_depth_and_no_label():
    scene = seen(ellipsoid(0.5, 0.5))
    hit = np.isfinite(scene.depth_m)
    assert (scene.labels == -1).all()
    assert scene.planes.shape == (0, 4)
    assert np.nanmin(scene.depth_m) == pytest.approx(2.5, abs=1e-3)
    np.testing.assert_allclose(np.linalg.norm(world_points(scene), axis=1), 0.5, atol=1e-4)
    # Its outline is a cone of sin = 1/6.
    assert hit.sum() == pytest.approx(np.pi * (131 / np.sqrt(35))**2, rel=0.02)


def test_curved_things_hide_planes_and_are_hidden():
    far, near = block([-2, 2, -2], [2, 3, 2]), block([-2, -1, 0.1], [2, -0.9, 2])
    scene = seen(joined(far, near, ellipsoid(0.4, 0.4)))
    assert scene.labels[60, 80] == -1
    assert scene.depth_m[60, 80] == pytest.approx(2.6, abs=0.01)
    assert scene.depth_m[40, 80] == pytest.approx(2.0)
    assert scene.depth_m[100, 60] == pytest.approx(5.0)
    assert len(scene.planes) == 3, 'two fronts and the lower side of the near one'
