# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Constants and pixels behind a mesh are discarded; walls and edges stay."""

import numpy as np
import pytest
from cell_helpers import FLOOR, millimetres, view, wall

from plane_detector import Config, PlaneDetector, segment_planes
from plane_detector.config import DepthConfig
from plane_detector.evaluation.benchmark.samples import curved_scene, noisy_depth, room
from plane_detector.evaluation.scenes.sensor_cases import mesh
from plane_detector.segmentation.cells.discarded import without_constants, without_far_layer
from plane_detector.segmentation.cells.grid import DisparityImage, build_cell_grid
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.segment import metric_noise_floor

NOISE_FLOOR = metric_noise_floor(Config())
V, U = np.mgrid[0:480, 0:640]
REGIONS = {'body': 380 - 60 * (abs(U - 320) < 200) < V, 'strip': U < 70,
           'blob': (V - 330) ** 2 + (U - 250) ** 2 < 70**2}


@pytest.mark.parametrize('value_m', [0.3, 1.0, 5.0, 65.535])
@pytest.mark.parametrize('region', REGIONS)
@pytest.mark.parametrize('noise', [0.001, 'active stereo'])
def test_a_mask_is_invalid_and_the_rest_keeps_its_planes(noise, region, value_m):
    scene, at = room(1), REGIONS[region]
    depth_m = noisy_depth(scene, noise, 1)
    if noise == 'active stereo' and value_m < 1:
        # So near its noise is a quarter of a millimetre: a front would be rounded to one value.
        kept_m = without_constants(np.where(at, np.float32(value_m), depth_m), NOISE_FLOOR)
        assert np.isfinite(kept_m[at]).all()
        return
    masked_m = np.where(at, np.float32(value_m), depth_m)
    kept_m = without_constants(masked_m, NOISE_FLOOR)
    assert np.isnan(kept_m[at]).mean() > 0.98
    np.testing.assert_array_equal(kept_m[~at & (depth_m != value_m)],
                                  depth_m[~at & (depth_m != value_m)])
    found = segment_planes(masked_m, scene.intrinsics)
    assert not (found.labels[at] >= 0).any()
    blanked = segment_planes(np.where(at, np.nan, depth_m).astype(np.float32), scene.intrinsics)
    assert abs((found.labels >= 0).mean() - (blanked.labels >= 0).mean()) < 0.01


@pytest.mark.parametrize('share', [0.1, 0.4])
@pytest.mark.parametrize('beyond_m', [None, 10.0, 65.535])
def test_what_lies_beyond_the_range_is_invalid(beyond_m, share):
    depth_m = noisy_depth(room(1), 0.001, 1)
    limit_m = np.float32(np.nanquantile(depth_m, 1 - share))
    far = depth_m >= limit_m
    kept_m = without_constants(np.where(far, np.float32(beyond_m or limit_m), depth_m),
                               NOISE_FLOOR)
    assert np.isnan(kept_m[far]).mean() > 0.98 and np.isfinite(kept_m[~far]).all()


@pytest.mark.parametrize('keep', [lambda depth_m: depth_m, millimetres,
                                  lambda depth_m: np.round(depth_m, 2).astype(np.float32)])
def test_exact_depth_stays_as_it_is(keep):
    # A wall seen from the front above a floor; beside one that is nearer; behind a pipe.
    for depth_m in (view([wall(3), FLOOR]).depth_m, view([wall(3), wall(2, 0, 500)]).depth_m,
                    curved_scene(29).depth_m, np.full((480, 640), 2.0, np.float32)):
        kept_m = keep(depth_m)
        assert without_constants(kept_m, NOISE_FLOOR) is kept_m


@pytest.mark.parametrize('noise', ['structured light', 'filled, 8 bit', 'whole cm'])
def test_steps_of_quantised_depth_are_no_constants(noise):
    for seed in range(3):
        depth_m = noisy_depth(room(seed), noise, seed)
        assert without_constants(depth_m, NOISE_FLOOR) is depth_m


def test_all_outputs_see_a_mask_as_invalid_and_it_is_said():
    scene, at = room(1), REGIONS['body']
    depth_m = np.where(at, np.float32(5.0), noisy_depth(scene, 0.001, 1))
    detector = PlaneDetector(Config(depth=DepthConfig(source='topic')))
    found = detector.detect(scene.rgb, scene.intrinsics, depth_m)
    assert np.isnan(found.depth_m[at]).all()
    assert found.constant_note.startswith(f'{at.sum()} pixels repeat the depth 5 m')
    seen = detector.estimate_depth(scene.rgb, scene.intrinsics, depth_m)
    np.testing.assert_array_equal(seen.constants_m, np.where(at, np.float32(5.0), np.nan))


def before_a_floor(front_m, at, noise, step_m, seed):
    """Return depth of a floor that ends 4 m away with something before it, noise k z**2."""
    z_m = np.where(at, front_m, np.minimum(460 / np.maximum(V - 240, 1), 4.0))
    z_m = z_m + np.random.default_rng(seed).normal(0, noise, z_m.shape) * z_m**2
    return (np.round(z_m / step_m) * step_m).astype(np.float32)


@pytest.mark.parametrize('step_m', [1e-3, 1e-4])
@pytest.mark.parametrize('front_m', [0.2, 0.37, 0.5, 0.8, 1.0])
def test_a_front_near_the_camera_is_rounded_to_one_depth_and_stays(front_m, step_m):
    at = (V >= 140) & (V < 390) & (U >= 190) & (U < 450)
    for seed, (noise, tilt_deg) in enumerate(
            [(0.0003, 0), (0.0005, 0.1), (0.001, 0), (0.001, 0.3), (0.002, 0.2), (0.003, 0)]):
        tilted_m = front_m / (1 - np.tan(np.radians(tilt_deg)) * (U - 320) / 460)
        depth_m = before_a_floor(tilted_m, at, noise, step_m, seed)
        kept_m = without_constants(depth_m, NOISE_FLOOR)
        assert np.isfinite(kept_m[at]).mean() > 0.99


def test_a_table_from_above_and_its_boxes_stay():
    for seed, table_m in enumerate((0.32, 0.41, 0.5)):
        z_m = np.where((U < 70) | (V > 400), 1.4 + 0.001 * U, table_m)
        for row, column, high_m in ((60, 120, 0.05), (200, 300, 0.11), (80, 450, 0.08)):
            z_m[row:row + 90, column:column + 110] = table_m - high_m
        noisy_m = z_m + np.random.default_rng(seed).normal(0, 8e-4, z_m.shape) * z_m**2
        depth_m = np.round(noisy_m, 3).astype(np.float32)
        assert np.isfinite(without_constants(depth_m, NOISE_FLOOR)).all()


@pytest.mark.parametrize('noise', [0.0007, 0.002])
def test_many_masks_of_several_depths_are_each_told(noise):
    at = np.zeros(V.shape, bool)
    value_m = np.full(V.shape, np.nan)
    for k, depth in enumerate((2.5, 6.0, 7.25, 9.0)):
        patch = (slice(40, 200), slice(20 + 155 * k, 140 + 155 * k))
        at[patch], value_m[patch] = True, depth
    depth_m = before_a_floor(1.0, np.zeros(V.shape, bool), noise, 1e-3, 5)
    kept_m = without_constants(np.where(at, value_m, depth_m).astype(np.float32), NOISE_FLOOR)
    assert np.isnan(kept_m[at]).mean() > 0.99 and np.isfinite(kept_m[~at]).mean() > 0.99


FAR = 0.5 + 0.0002 * U


def near_layer(disparity, noise=0.001):
    """Return the image without what is seen through a mesh, its grid, and the image as given."""
    rng = np.random.default_rng(0)
    noisy = (disparity + noise * rng.standard_normal(disparity.shape)).astype(np.float32)
    image = DisparityImage(noisy, noisy > 0)
    return *without_far_layer(image, build_cell_grid(image), NOISE_FLOOR), image


@pytest.mark.parametrize('is_solid', [
    U % 3 > 0, (U % 4 > 0) & (V % 4 > 0), V % 13 < 9, (U + V) % 5 > 1,
    np.random.default_rng(1).random(U.shape) < 0.6])
def test_pixels_behind_a_mesh_are_left_out(is_solid):
    """Of a mesh that fills the image, and so sets all that the image shows as noise."""
    found, grid, _ = near_layer(np.where(is_solid, FAR + 0.2, FAR))
    assert (found.valid == is_solid).mean() > 0.98
    assert grid.is_mesh.mean() > 0.75


def poles(width_px):
    """Return two poles, a cable and a board before a wall."""
    is_near = (abs(U - 200) < width_px) | (abs(V - 100 - U // 3) < width_px / 2) | (
        (abs(U - 450) < 60) & (abs(V - 300) < 90)) | (abs(U - 3 * V) < width_px)
    return np.where(is_near, FAR + 0.3, FAR)


@pytest.mark.parametrize('disparity', [
    FAR, poles(2), poles(6), np.where(V > 2 * U / 3, FAR + 0.3, FAR), np.rint(FAR * 100) / 100,
    0.5 + 0.1 * np.hypot(U - 320, V - 240) / 240], ids=[
    'wall', 'thin poles', 'poles', 'edge', 'steps', 'cone'])
@pytest.mark.parametrize('noise', [0.0005, 0.004, 0.03])
def test_edges_poles_steps_and_noise_are_no_mesh(disparity, noise):
    found, _, image = near_layer(disparity, noise)
    assert found is image


def test_a_wall_that_is_one_of_two_steps_of_the_sensor_by_chance_is_no_mesh():
    """Seen from the front, in steps of a pixel of disparity."""
    rng = np.random.default_rng(0)
    values = np.where(rng.random(U.shape) < 0.4, 0.38, 0.40).astype(np.float32)
    image = DisparityImage(values, values > 0)
    grid = build_cell_grid(image)
    assert without_far_layer(image, grid, Noise(0.0005, 0.02 / 12**0.5))[0] is image


def of_mesh(seed):
    """Return the share of a mesh in one plane, how far that is off it, and the stated error."""
    scene, depth_m = mesh(np.random.default_rng(seed))
    surface = int(np.flatnonzero(scene.rectangles == 1)[0])
    found, on = segment_planes(depth_m, scene.intrinsics), scene.labels == surface
    counts = np.bincount(found.labels[on] + 1, minlength=2)[1:]
    plane, truth = found.planes[int(counts.argmax())], scene.planes[surface]
    here = np.append(plane.centroid_m, 1.0)
    return counts.max() / on.sum(), abs(truth @ here), (here @ plane.covariance @ here) ** 0.5


@pytest.mark.parametrize('seed', [9000, 9004, 9007, 9013, 9016, 9021, 9022, 9023])
def test_a_mesh_is_one_plane_with_an_honest_error(seed):
    """Mesh and bars, stereo and time of flight, sharp and mixed; of the mean, both 2 to 40 cm."""
    share, off_m, sigma_m = of_mesh(seed)
    assert share > 0.85
    assert off_m < 3 * sigma_m
    assert sigma_m < 0.02
