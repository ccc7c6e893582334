# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Planes of rendered scenes against their truth."""

import numpy as np
import pytest
from cell_helpers import noisy, scored, wall

from plane_detector import Config, segment_planes
from plane_detector.config import SegmentationConfig
from plane_detector.evaluation.metrics import angle_deg, overlap, segmentation_covering
from plane_detector.evaluation.scenes.rendering import (
    VGA,
    box,
    camera_rotation,
    rectangle,
    render,
)
from plane_detector.evaluation.scenes.rooms import random_room, single_wall, staircase
from plane_detector.types import CameraIntrinsics

FLOOR = rectangle([-6, -1, 0], [12, 0, 0], [0, 7, 0])
WALL = rectangle([-6, 6, 0], [12, 0, 0], [0, 0, 4])


def seen(faces, pitch_deg=0.0, height_m=0.0):
    """Return the scene of a camera that looks along y."""
    return render(faces, camera_rotation(0, pitch_deg, 0), np.array([0, 0, height_m]), VGA,
                  np.random.default_rng(0))


def label_at(scene, found, point_m, pitch_deg, height_m):
    """Return the label of the pixel of :func:`seen` that sees a point of the world."""
    x, y, z = camera_rotation(0, pitch_deg, 0).T @ (np.array(point_m) - [0, 0, height_m])
    return found.labels[round(y / z * VGA.fy + VGA.cy), round(x / z * VGA.fx + VGA.cx)]


def test_every_tread_and_riser_is_its_own_plane():
    scene = staircase()
    found = segment_planes(scene.depth_m, scene.intrinsics)
    shared = overlap(scene.labels, found.labels, np.isfinite(scene.depth_m))
    rows = np.array([np.ptp(np.nonzero(scene.labels == k)[0]) + 1
                     for k in range(len(scene.planes))])
    large = np.flatnonzero((shared.counts[:-1].sum(1) > 1500) & (rows >= 7))
    assert len(large) == 13
    assert (shared.iou[large].max(axis=1) > 0.5).all()
    assert len(set(shared.iou[large].argmax(axis=1))) == len(large)


@pytest.mark.parametrize('sigma', [0.0, 0.001, 0.004, 0.01])
@pytest.mark.parametrize('yaw_deg', [0.0, 20.0, 50.0])
def test_a_single_wall_is_one_plane(sigma, yaw_deg):
    scene = single_wall(yaw_deg=yaw_deg)
    depth_m = noisy(scene, 1, sigma)
    found = segment_planes(depth_m, VGA)
    assert len(found.planes) == 1
    assert (found.labels[np.isfinite(depth_m)] == 0).mean() > 0.97
    result = scored(scene, found)
    assert result.normal_error_deg < (0.01 if sigma == 0 else 1.5)
    assert result.offset_error_m < (1e-3 if sigma == 0 else 0.05)


def test_where_everything_is_curved_there_is_no_plane():
    v, u = np.mgrid[:480, :640]
    depth_m = 2.0 + 0.6 * np.sin(u / 9.0) * np.cos(v / 11.0) + 0.3 * np.sin(v / 4.0)
    found = segment_planes(depth_m, VGA)
    assert not len(found.planes) and (found.labels == -1).all()


def test_an_image_frame_two_centimetres_off_the_wall_is_its_own_plane():
    scene = seen([wall(2.0), *box(np.array([0.1, 1.99, 0.1]), np.array([0.6, 0.02, 0.5]))])
    found = segment_planes(scene.depth_m, VGA)
    assert sorted(plane.offset_m for plane in found.planes) == pytest.approx([1.98, 2.0], abs=1e-3)
    assert scored(scene, found).segmentation_covering > 0.98


@pytest.mark.parametrize('gap_m', [0.3, 0.6])
def test_a_table_and_a_sofa_of_one_height_stay_two(gap_m):
    middle = gap_m / 2 + 0.5
    things = [face for x in (-middle, middle)
              for face in box(np.array([x, 3.0, 0.25]), np.array([1.0, 0.8, 0.5]))]
    scene = seen([FLOOR, WALL, *things], -25, 1.6)
    found = segment_planes(scene.depth_m, VGA)
    left, right = (label_at(scene, found, (x, 3.0, 0.5), -25, 1.6) for x in (-middle, middle))
    assert min(left, right) >= 0 and left != right


def test_a_pillar_does_not_cut_the_wall_behind_it():
    scene = seen([FLOOR, WALL, *box(np.array([0, 3.0, 2.0]), np.array([0.3, 0.3, 4.0]))],
                 -10, 1.5)
    found = segment_planes(scene.depth_m, VGA)
    left, right = (label_at(scene, found, (x, 6.0, 1.5), -10, 1.5) for x in (-2, 2))
    assert left == right >= 0


def test_a_wide_border_without_depth_costs_nothing_within(room):
    scene = room(7)
    inside = np.zeros(scene.depth_m.shape, bool)
    inside[45:-30, 60:-45] = True
    found = segment_planes(np.where(inside, scene.depth_m, np.float32(np.nan)), VGA)
    assert (found.labels[~inside] == -1).all()
    shared = overlap(scene.labels, found.labels, inside)
    assert segmentation_covering(shared.counts) > 0.93


def test_a_street_to_eighty_metres_under_a_sky_without_depth():
    scene = seen([rectangle([-40, 1, 0], [80, 0, 0], [0, 79, 0]),
                  rectangle([5, 8, 0], [0, 25, 0], [0, 0, 7])], 0, 1.6)
    found = segment_planes(scene.depth_m, VGA)
    assert (found.labels[np.isnan(scene.depth_m)] == -1).all()
    result = scored(scene, found)
    assert len(found.planes) == 2 and (result.recall, result.precision) == (1, 1)
    assert result.normal_error_deg < 0.1


def test_no_plane_is_smaller_than_wanted(room):
    config = Config(segmentation=SegmentationConfig(min_plane_share=0.05))
    found = segment_planes(room(3).depth_m, VGA, config)
    assert min(plane.inlier_count for plane in found.planes) >= 0.05 * found.labels.size


def test_known_noise_is_a_lower_bound(room):
    exact = segment_planes(room(3).depth_m, VGA)
    found = segment_planes(room(3).depth_m, VGA, disparity_noise=0.02)
    assert exact.disparity_noise < 0.001 and found.disparity_noise >= 0.02
    assert len(found.planes) <= len(exact.planes)


CAMERAS = {'0.3 w': (192, 192, 319.5), '2 w': (1280, 1280, 319.5), '4 w': (2560, 2560, 319.5),
           'fx is not fy': (512, 768, 319.5), 'off centre': (1280, 800, 447.5)}


def two_walls(camera, angle_deg):
    """Return the depth of two walls that meet at an angle in the middle column, 2 m ahead."""
    ray = (np.arange(camera.width) - camera.cx) / camera.fx
    middle = ((camera.width - 1) / 2 - camera.cx) / camera.fx
    slope = np.sign(ray - middle) * np.tan(np.radians(angle_deg / 2))
    depth_m = 2.0 * (1 - slope * middle) / (1 - slope * ray)
    return np.tile(depth_m.astype(np.float32), (camera.height, 1))


@pytest.mark.parametrize('name', CAMERAS)
def test_walls_are_two_from_the_same_angle_on_for_every_lens(name):
    fx, fy, cx = CAMERAS[name]
    camera = CameraIntrinsics(fx, fy, cx, 239.5, 640, 480)
    assert len(segment_planes(two_walls(camera, 5.0), camera).planes) == 2
    assert len(segment_planes(two_walls(camera, 1.0), camera).planes) == 1


@pytest.mark.parametrize('width, height', [(64, 48), (80, 60), (96, 72), (100, 76)])
def test_rooms_in_small_images(width, height):
    camera = CameraIntrinsics.from_field_of_view(width, height, 60.0)
    for seed in range(6):
        scene = random_room(np.random.default_rng(seed), camera)
        found = segment_planes(scene.depth_m, camera)
        assert scored(scene, found).segmentation_covering > 0.9


def test_depth_of_every_second_row_is_as_good_as_all():
    camera = CameraIntrinsics.from_field_of_view(640, 480, 60.0)
    depth_m = two_walls(camera, 40.0)
    sparse = depth_m.copy()
    sparse[(np.arange(480) // 4) % 2 == 1] = np.nan  # the middle rows of all cells
    found, whole = (segment_planes(one, camera).planes for one in (sparse, depth_m))
    assert len(found) == 2
    for one, other in zip(found, whole, strict=True):
        assert angle_deg(one.normal, other.normal) < 0.02
