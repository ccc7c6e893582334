# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Whatever comes in as depth: the result is consistent, and no error where there is no reason."""

import cv2
import numpy as np
import pytest
from cell_helpers import noisy

from plane_detector import CameraIntrinsics, Config, PlaneDetector, segment_planes
from plane_detector.config import DepthConfig, SegmentationConfig
from plane_detector.evaluation.peers import plane_array
from plane_detector.evaluation.scenes.rendering import VGA
from plane_detector.evaluation.scenes.sensor_cases import SENSOR_CASES
from plane_detector.geometry.disparity import to_disparity
from plane_detector.segmentation.cells.noise import DepthKind
from plane_detector.segmentation.segment import (
    metric_noise_floor,
    segment,
    unitless_noise_floor,
)

pytestmark = pytest.mark.filterwarnings('error')


def consistent(depth_m, camera=VGA):
    """
    Segment, and check what holds of every result.

    Every label has a plane, largest first, every plane has pixels, and no label is without depth.
    """
    found = segment_planes(depth_m, camera)
    labels, planes = found.labels, found.planes
    assert labels.shape == depth_m.shape and labels.dtype == np.int32
    np.testing.assert_array_equal(np.unique(labels[labels >= 0]), np.arange(len(planes)))
    assert labels.min(initial=-1) >= -1
    assert (labels[~(np.isfinite(depth_m) & (depth_m > 0))] == -1).all()
    assert (np.diff([plane.inlier_count for plane in planes]) <= 0).all()
    for k, plane in enumerate(planes):
        assert plane.inlier_count == (labels == k).sum() > 0
        assert np.linalg.norm(plane.normal) == pytest.approx(1)
        assert plane.offset_m >= 0
        assert plane.normal @ plane.centroid_m + plane.offset_m == pytest.approx(0, abs=1e-6)
        assert np.isfinite([plane.confidence, *plane.covariance.ravel()]).all()
        assert 0 <= plane.rms_m < np.inf and 0 < plane.area_m2 < np.inf
    return found


@pytest.mark.parametrize('sigma', [0.0, 0.01])
@pytest.mark.parametrize('seed', [3, 7])
def test_labels_and_planes_belong_together(room, seed, sigma):
    depth_m = noisy(room(seed), seed, sigma).copy()
    depth_m[:50, :70] = np.nan
    depth_m[100:130, 200:260] = 0
    depth_m[300:, 600:] = np.inf
    depth_m[5:9, 400:] = -2
    assert len(consistent(depth_m).planes) > 3


@pytest.mark.parametrize('shape', [(1, 1), (1, 40), (7, 5), (480, 640)])
@pytest.mark.parametrize('fill', [np.nan, np.inf, -np.inf, 0.0, -1.0, 1e30])
def test_no_usable_depth_is_no_error_and_no_warning(shape, fill):
    camera = CameraIntrinsics(100.0, 100.0, 1.0, 1.0, shape[1], shape[0])
    found = consistent(np.full(shape, fill, np.float32), camera)
    assert fill == 1e30 or not len(found.planes)


@pytest.mark.parametrize('shape', [(2, 2), (3, 3), (8, 8), (24, 32)])
def test_tiny_images_are_segmented_or_not_but_never_wrong(shape):
    camera = CameraIntrinsics(30.0, 30.0, 0.5, 0.5, shape[1], shape[0])
    found = consistent(np.full(shape, 2.0, np.float32), camera)
    assert len(found.planes) <= 1
    for plane in plane_array(found):
        np.testing.assert_allclose(plane, [0, 0, -1, 2], atol=1e-3)


@pytest.mark.parametrize('absurd_m', [1e-20, 0.01, 1e20])
def test_one_absurd_pixel_changes_nothing_around_it(room, absurd_m):
    depth_m = room(7).depth_m.copy()
    before = segment_planes(depth_m, VGA)
    depth_m[100, 100] = absurd_m
    after = segment_planes(depth_m, VGA)
    assert (after.labels == before.labels).mean() > 0.99
    np.testing.assert_allclose(plane_array(after), plane_array(before), atol=1e-3)


def test_an_image_of_twelve_million_pixels():
    camera = CameraIntrinsics.from_field_of_view(4000, 3000, 60.0)
    ray_y = (np.arange(3000)[:, None] - camera.cy) / camera.fy
    ray_x = (np.arange(4000)[None, :] - camera.cx) / camera.fx
    floor_m = 1.5 / np.maximum(ray_y, 1e-6)
    wall_m = 5.0 / (1 + 0.3 * ray_x)
    found = consistent(np.minimum(floor_m, wall_m).astype(np.float32), camera)
    wall, floor = found.planes
    assert floor.offset_m == pytest.approx(1.5, abs=1e-3)
    assert wall.offset_m == pytest.approx(5 / np.hypot(1, 0.3), abs=2e-3)
    assert (found.labels == (floor_m < wall_m)).mean() > 0.995


def test_precision_and_layout_of_the_input_do_not_matter(room):
    depth_m = room(7).depth_m
    padded = np.zeros((960, 1280), np.float32)
    padded[::2, ::2] = depth_m
    before = segment_planes(depth_m, VGA)
    for same_m in (depth_m.astype(np.float64), np.asfortranarray(depth_m), padded[::2, ::2],
                   depth_m.astype('>f4')):
        found = segment_planes(same_m, VGA)
        np.testing.assert_array_equal(found.labels, before.labels)
        np.testing.assert_array_equal(plane_array(found), plane_array(before))


@pytest.mark.parametrize('depth', [
    np.ones((480, 640), np.uint16), np.ones((640, 480), np.float32), np.ones(4, np.float32)])
def test_what_is_no_depth_image_is_refused(depth):
    with pytest.raises(ValueError, match='depth'):
        segment_planes(depth, VGA)


def room_corner(size, holes=0.0, noise=0.0, seed=0):
    """Return depth of a floor and a wall, the pixels of the floor, and the camera 1 m above."""
    width, height = size
    camera = CameraIntrinsics.from_field_of_view(width, height, 70.0)
    v, u = np.indices((height, width))
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy,
                     np.ones(v.shape)], -1)
    down, ahead = np.array([0, np.cos(0.45), np.sin(0.45)]), np.array([0, -np.sin(0.45),
                                                                    np.cos(0.45)])
    floor_m, wall_m = 1 / np.maximum(rays @ down, 1e-6), 2.4 / (rays @ ahead)
    z_m, rng = np.minimum(floor_m, wall_m), np.random.default_rng(seed)
    noisy_m = z_m + rng.normal(0, 1, z_m.shape) * noise * z_m**2
    kept_m = np.where(rng.random(z_m.shape) < holes, np.nan, np.round(noisy_m, 3))
    return kept_m.astype(np.float32), floor_m < wall_m, camera


@pytest.mark.parametrize('size', [(160, 120), (128, 96), (96, 72), (64, 48)])
@pytest.mark.parametrize('holes', [0.0, 0.2, 0.35])
def test_small_images_with_holes_have_their_planes(size, holes):
    for seed in range(3):
        depth_m, is_floor, camera = room_corner(size, holes, 0.002, seed)
        found = segment_planes(depth_m, camera)
        seen = found.labels[is_floor & np.isfinite(depth_m)]
        best = max(range(len(found.planes)), key=lambda k: (seen == k).sum())
        assert (seen == best).mean() > 0.9
        assert found.planes[best].offset_m == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize('size', [(16, 16), (20, 15), (24, 24), (32, 24)])
def test_arrays_of_few_pixels_have_their_largest_plane(size):
    for seed in range(3):
        depth_m, is_floor, camera = room_corner(size, 0.0, 0.002, seed)
        found = PlaneDetector(Config(depth=DepthConfig(source='topic'))).detect(
            np.zeros((*depth_m.shape, 3), np.uint8), camera, depth_m,
            np.array([0, np.cos(0.45), np.sin(0.45)]), camera_height_m=1.0)
        assert (found.labels[is_floor] == 0).mean() > 0.8
        assert found.planes[0].offset_m == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize('size', [(64, 48), (128, 96), (224, 172), (320, 240)])
def test_the_near_floor_has_ten_times_the_noise_of_the_wall_in_time_of_flight(size):
    """Noise of 4 mm at any distance is .025 1/m at .4 m, and .0005 at 3 m."""
    width, height = size
    camera = CameraIntrinsics.from_field_of_view(width, height, 60.0)
    ray_y = (np.indices((height, width))[0] - camera.cy) / camera.fy
    down = np.array([0.0, np.cos(0.26), np.sin(0.26)])
    with np.errstate(divide='ignore'):
        floor_m = 0.25 / np.maximum(ray_y * down[1] + down[2], 0)
    wall_m = 3.5 / (np.cos(0.26) - ray_y * np.sin(0.26))
    z_m, is_near = np.minimum(floor_m, wall_m), floor_m < 0.8
    for seed in range(6):
        rng = np.random.default_rng(seed)
        noisy_m = z_m + (0.004 + 0.002 * z_m**2) * rng.standard_normal(z_m.shape)
        found = segment_planes(np.round(noisy_m, 3), camera)
        near = found.labels[is_near]
        floor = max(range(len(found.planes)), key=lambda k: (near == k).sum())
        assert (near == floor).mean() > 0.9
        assert found.planes[floor].offset_m == pytest.approx(0.25, abs=0.01)


def test_too_few_pixels_for_planes_are_said():
    depth_m = np.random.default_rng(0).normal(1, 0.01, (8, 8))
    found = segment_planes(depth_m, CameraIntrinsics.from_field_of_view(8, 8, 60.0))
    assert len(found.planes) == 0 and '8 x 8 pixels are too few' in found.plane_note


@pytest.mark.parametrize('background_m, sigma', [(30, 0.006), (45, 0.006), (60, 0.006)])
def test_a_noisy_background_does_not_drop_the_floor_before_it(background_m, sigma):
    v = np.indices((480, 640))[0]
    disparity = np.where(v > 410, (v - 240) / 460 / 1.1, 1 / background_m)
    disparity += sigma * cv2.GaussianBlur(
        np.random.default_rng(3).normal(0, 1, v.shape), (0, 0), 3) * 10.6
    found = segment_planes(1 / np.maximum(disparity, 0.002),
                           CameraIntrinsics(460.0, 460.0, 319.5, 239.5, 640, 480))
    near = found.labels[415:]
    assert max((near == k).mean() for k in range(len(found.planes))) > 0.95
    assert 'dropped' in found.plane_note


@pytest.mark.parametrize('noise_m, step_m', [(4e-5, 0.6e-3), (6e-5, 0.8e-3)])
def test_thin_plates_in_fine_depth_are_told_from_their_table(noise_m, step_m):
    rng, at = np.random.default_rng(4), (slice(150, 290), slice(200, 420))
    depth_m = np.full((480, 640), 0.8)
    depth_m[at] -= step_m
    depth_m += noise_m * cv2.GaussianBlur(rng.normal(0, 1, depth_m.shape), (0, 0), 0.8) * 2.8
    camera = CameraIntrinsics.from_field_of_view(640, 480, 40.0)
    found = segment_planes(depth_m, camera, Config(
        segmentation=SegmentationConfig(flatness_distance=0.0)))
    plate, table = found.labels[220, 300], found.labels[50, 50]
    assert plate >= 0 and table >= 0 and plate != table
    assert found.planes[table].offset_m - found.planes[plate].offset_m == pytest.approx(
        step_m, abs=0.1 * step_m)


def test_stated_noise_of_a_sensor_is_a_bound_and_does_not_make_it_a_network():
    depth_m, _, camera = room_corner((320, 240), 0.0, 0.002)
    disparity = to_disparity(depth_m)
    config = Config(segmentation=SegmentationConfig(disparity_noise=0.003))
    noise = segment(disparity, metric_noise_floor(config), config).noise
    assert noise.kind(0.5) is DepthKind.MEASURED and noise.mean_sigma >= 0.003
    assert unitless_noise_floor(disparity).is_metric is False


def tops_on_a_pallet(tilts_deg, seed, noise_px=0.05):
    """
    Return depth of boxes from above, as stereo sees them, and a mask and the normal of each top.

    Twelve of 20 x 15 cm, 1.2 cm apart, 1.34 m below the camera; each tilts in another direction.
    """
    camera = CameraIntrinsics(925.0, 925.0, 639.5, 359.5, 1280, 720)
    rng = np.random.default_rng(seed)
    v, u = np.indices((720, 1280))
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy,
                     np.ones(v.shape)], -1)
    depth_m, tops = np.full(v.shape, 1.6), []
    depth_m[(abs(rays[..., :2] * 1.45) <= (0.5, 0.4)).all(axis=-1)] = 1.45
    for k, tilt_deg in enumerate(tilts_deg):
        centre = np.array([(k % 4 - 1.5) * 0.212, (k // 4 - 1) * 0.162, 1.34])
        tilt, towards = np.radians(tilt_deg), rng.uniform(0, 2 * np.pi)
        normal = np.array([np.sin(tilt) * np.cos(towards), np.sin(tilt) * np.sin(towards),
                           np.cos(tilt)])
        top_m = centre @ normal / (rays @ normal)
        is_top = (abs(rays[..., :2] * top_m[..., None] - centre[:2]) <= (0.1, 0.075)).all(axis=-1)
        depth_m[is_top] = top_m[is_top]
        tops.append((cv2.erode(is_top.astype(np.uint8), np.ones((9, 9))) > 0, normal))
    noise = cv2.GaussianBlur(rng.standard_normal(v.shape), (0, 0), 2.0)
    seen = 1 / depth_m + noise_px / (925 * 0.055) * noise / noise.std()
    return np.round(1 / seen, 3), tops, camera


@pytest.mark.parametrize('seed', [9000, 9002])
def test_filtered_depth_has_the_noise_floor_of_millimetres(seed):
    """It is finer, but has noise enough in its cells; with a finer floor .79 were in one plane."""
    scene, depth_m = SENSOR_CASES['filtered'](np.random.default_rng(seed))
    found = segment_planes(depth_m, scene.intrinsics)
    largest = np.isfinite(depth_m) & (scene.labels == np.bincount(
        scene.labels[scene.labels >= 0]).argmax())
    assert np.bincount(found.labels[largest] + 1)[1:].max() > 0.95 * largest.sum()


@pytest.mark.parametrize('tilts_deg', [(0, 0, 4, 0, 0, 0, 0, 3, 6, 0, 0, 0),
                                       (3, 0, 0, 0, 0, 5, 0, 0, 0, 0, 0, 3)])
def test_tilted_tops_beside_level_ones_have_their_own_plane(tilts_deg):
    """Structure is not mistaken for bending, nor tops that do not touch for one plane."""
    for seed in range(9000, 9003):
        depth_m, tops, camera = tops_on_a_pallet(tilts_deg, seed)
        found = segment_planes(depth_m, camera, Config(
            segmentation=SegmentationConfig(flatness_distance=0.0)))
        for mask, normal in tops:
            plane = np.bincount(found.labels[mask] + 1, minlength=2)[1:].argmax()
            assert (found.labels[mask] == plane).mean() > 0.7
            assert abs(found.planes[plane].normal @ normal) > np.cos(np.radians(1.0))


@pytest.mark.parametrize('size', [(64, 48), (128, 96)])
def test_time_of_flight_whose_noise_does_not_grow_shows_the_near_floor(size):
    """Noise of 4 mm at any distance is much in 1/z near the camera."""
    for seed in range(9000, 9004):
        exact_m, is_floor, camera = room_corner(size)
        rng = np.random.default_rng(seed)
        depth_m = exact_m + rng.normal(0, 0.004, exact_m.shape)
        found = segment_planes(depth_m.astype(np.float32), camera)
        seen = found.labels[is_floor]
        best = np.bincount(seen + 1, minlength=2)[1:].argmax()
        assert (seen == best).mean() > 0.9
        assert found.planes[best].offset_m == pytest.approx(1.0, abs=0.01)
