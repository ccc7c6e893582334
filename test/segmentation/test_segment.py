# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Planes of rendered scenes against their truth."""

import numpy as np
import pytest

from plane_detector import Config, segment_planes
from plane_detector.config import SegmentationConfig
from plane_detector.evaluation.metrics import overlap, score
from plane_detector.evaluation.peers import plane_array
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rooms import (
    VGA,
    Rectangle,
    bumps,
    camera_rotation,
    random_room,
    render,
    single_wall,
    staircase,
)
from plane_detector.evaluation.scenes.rooms import box as upright_box
from plane_detector.types import CameraIntrinsics

ROOMS = (3, 7, 11)
FLOOR = Rectangle(np.array([-6.0, -1.0, 0.0]), np.array([12.0, 0, 0]), np.array([0, 7.0, 0]))
WALL = Rectangle(np.array([-6.0, 6.0, 0.0]), np.array([12.0, 0, 0]), np.array([0, 0, 4.0]))


def scored(scene, segmentation):
    return score(scene.labels, scene.planes, segmentation.labels, plane_array(segmentation),
                 np.isfinite(scene.depth_m))


def shared_with(scene, segmentation):
    return overlap(scene.labels, segmentation.labels, np.isfinite(scene.depth_m))


def plane_under(scene, segmentation, point_m, world_from_camera, position):
    """Return the label of the pixel that sees a point of the world."""
    x, y, z = world_from_camera.T @ (np.asarray(point_m, float) - position)
    column = round(x / z * scene.intrinsics.fx + scene.intrinsics.cx)
    row = round(y / z * scene.intrinsics.fy + scene.intrinsics.cy)
    return segmentation.labels[row, column]


def test_every_tread_and_riser_is_its_own_plane():
    scene = staircase()
    shared = shared_with(scene, segment_planes(scene.depth_m, scene.intrinsics))
    rows = np.array([np.ptp(np.nonzero(scene.labels == k)[0]) + 1
                     for k in range(len(scene.planes))])
    large = np.flatnonzero((shared.counts[:-1].sum(1) > 1500) & (rows >= 7))
    assert len(large) == 13
    assert (shared.iou[large].max(axis=1) > 0.5).all()
    assert len(set(shared.iou[large].argmax(axis=1))) == len(large)


@pytest.mark.parametrize('sigma', [0.0, 0.004, 0.01])
@pytest.mark.parametrize('yaw_deg', [0.0, 20.0, 50.0])
def test_a_single_wall_is_one_plane(sigma, yaw_deg):
    scene = single_wall(yaw_deg=yaw_deg)
    depth_m = with_disparity_noise(scene.depth_m, sigma, np.random.default_rng(1))
    found = segment_planes(depth_m, scene.intrinsics)
    assert len(found.planes) == 1
    seen = np.isfinite(depth_m)
    assert (found.labels[seen] == 0).mean() > 0.97
    cosine = np.clip(found.planes[0].normal @ scene.planes[0, :3], -1, 1)
    assert np.degrees(np.arccos(cosine)) < (0.01 if sigma == 0 else 1.5)
    assert found.planes[0].offset_m == pytest.approx(3, abs=1e-3 if sigma == 0 else 0.05)


def test_where_everything_is_curved_there_is_no_plane():
    scene = bumps()
    found = segment_planes(scene.depth_m, scene.intrinsics)
    assert found.planes == ()
    assert (found.labels == -1).all()


def test_an_image_frame_two_centimetres_off_the_wall_is_its_own_plane():
    wall = Rectangle(np.array([-3.0, 2.0, -3.0]), np.array([6.0, 0, 0]), np.array([0, 0, 6.0]))
    frame = upright_box(np.array([0.1, 1.99, 0.1]), np.array([0.6, 0.02, 0.5]))
    scene = render([wall, *frame], camera_rotation(0, 0, 0), np.zeros(3), VGA,
                   np.random.default_rng(0))
    found = segment_planes(scene.depth_m, scene.intrinsics)
    offsets_m = sorted(plane.offset_m for plane in found.planes)
    assert offsets_m == pytest.approx([1.98, 2.0], abs=1e-3)
    assert scored(scene, found).segmentation_covering > 0.98


@pytest.mark.parametrize('gap_m', [0.3, 0.6])
def test_a_table_and_a_sofa_of_one_height_stay_two(gap_m):
    rotation, position = camera_rotation(0, -25, 0), np.array([0, 0, 1.6])
    middle = gap_m / 2 + 0.5
    table, sofa = (upright_box(np.array([x, 3.0, 0.25]), np.array([1.0, 0.8, 0.5]))
                   for x in (-middle, middle))
    scene = render([FLOOR, WALL, *table, *sofa], rotation, position, VGA,
                   np.random.default_rng(0))
    found = segment_planes(scene.depth_m, scene.intrinsics)
    left, right = (plane_under(scene, found, (x, 3.0, 0.5), rotation, position)
                   for x in (-middle, middle))
    assert left >= 0
    assert right >= 0
    assert left != right


def test_a_pillar_does_not_cut_the_wall_behind_it():
    rotation, position = camera_rotation(0, -10, 0), np.array([0, 0, 1.5])
    pillar = upright_box(np.array([0, 3.0, 2.0]), np.array([0.3, 0.3, 4.0]))
    scene = render([FLOOR, WALL, *pillar], rotation, position, VGA, np.random.default_rng(0))
    found = segment_planes(scene.depth_m, scene.intrinsics)
    left, right = (plane_under(scene, found, (x, 6.0, 1.5), rotation, position) for x in (-2, 2))
    assert left == right >= 0


def test_a_wide_border_without_depth_costs_nothing_within(room):
    scene = room(ROOMS[1])
    depth_m = scene.depth_m.copy()
    inside = np.zeros(depth_m.shape, bool)
    inside[45:-30, 60:-45] = True
    depth_m[~inside] = np.nan
    found = segment_planes(depth_m, scene.intrinsics)
    assert (found.labels[~inside] == -1).all()
    result = score(scene.labels, scene.planes, found.labels, plane_array(found), inside)
    assert result.segmentation_covering > 0.93


def test_a_street_to_eighty_metres_under_a_sky_without_depth():
    road = Rectangle(np.array([-40.0, 1.0, 0]), np.array([80.0, 0, 0]), np.array([0, 79.0, 0]))
    house = Rectangle(np.array([5.0, 8.0, 0]), np.array([0, 25.0, 0]), np.array([0, 0, 7.0]))
    scene = render([road, house], camera_rotation(0, 0, 0), np.array([0, 0, 1.6]), VGA,
                   np.random.default_rng(0))
    found = segment_planes(scene.depth_m, scene.intrinsics)
    assert (found.labels[np.isnan(scene.depth_m)] == -1).all()
    assert len(found.planes) == 2
    result = scored(scene, found)
    assert (result.recall, result.precision) == (1, 1)
    assert result.normal_error_deg < 0.1


def test_no_plane_is_smaller_than_wanted(room):
    config = Config(segmentation=SegmentationConfig(min_plane_share=0.05))
    scene = room(ROOMS[0])
    found = segment_planes(scene.depth_m, scene.intrinsics, config)
    assert found.planes
    assert min(plane.inlier_count for plane in found.planes) >= 0.05 * scene.depth_m.size


def test_known_noise_is_a_lower_bound(room):
    scene = room(ROOMS[0])
    found = segment_planes(scene.depth_m, scene.intrinsics, disparity_noise=0.02)
    assert found.disparity_noise >= 0.02
    exact = segment_planes(scene.depth_m, scene.intrinsics)
    assert exact.disparity_noise < 0.001
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
    covering = []
    for seed in range(6):
        scene = random_room(np.random.default_rng(seed), camera)
        found = segment_planes(scene.depth_m.astype(np.float32), camera)
        planes = np.array([[*plane.normal, plane.offset_m] for plane in found.planes])
        covering.append(score(scene.labels, scene.planes, found.labels, planes,
                              np.isfinite(scene.depth_m)).segmentation_covering)
    assert min(covering) > 0.9


def test_depth_of_every_second_row_is_as_good_as_all():
    camera = CameraIntrinsics.from_field_of_view(640, 480, 60.0)
    depth_m = two_walls(camera, 40.0)
    sparse = depth_m.copy()
    sparse[(np.arange(480) // 4) % 2 == 1] = np.nan  # the middle rows of all cells
    found = segment_planes(sparse, camera)
    assert len(found.planes) == 2
    whole = segment_planes(depth_m, camera)
    for one, other in zip(found.planes, whole.planes, strict=True):
        assert np.degrees(np.arccos(min(abs(one.normal @ other.normal), 1.0))) < 0.02
