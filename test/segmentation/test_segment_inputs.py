# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Whatever comes in as depth: the result is consistent, and no error where there is no reason."""

import numpy as np
import pytest
from cell_helpers import noisy

from plane_detector import CameraIntrinsics, segment_planes
from plane_detector.evaluation.peers import plane_array
from plane_detector.evaluation.scenes.rendering import VGA

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
    camera = CameraIntrinsics(50.0, 50.0, 1.0, 1.0, shape[1], shape[0])
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
