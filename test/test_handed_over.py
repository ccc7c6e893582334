# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
What one stage hands to the next: units, valid pixels, errors, and the frame they are in.

The same scene moved, mirrored, turned, scaled, in another unit or with other noise must give the
same planes, moved, mirrored, turned, scaled.
"""

from dataclasses import replace

import numpy as np
import pytest

from plane_detector import CameraIntrinsics, Config, PlaneDetector, network_steps, segment_planes
from plane_detector.config import DepthConfig, DirectionsConfig, ScaleConfig
from plane_detector.depth.observation import DepthFunction
from plane_detector.evaluation.metrics import angle_deg, overlap
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rendering import camera_rotation, rectangle, render
from plane_detector.evaluation.scenes.rooms import box, random_room
from plane_detector.evaluation.scenes.textures import textured
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.segmentation.cells.grid import DisparityImage, build_cell_grid
from plane_detector.segmentation.cells.model import MEAN_WEIGHT, PixelRegions, weigh_cells
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.tracking.camera_motion import PlaneMotion
from plane_detector.types import Plane, Planes

LARGE = CameraIntrinsics(525.0, 560.0, 300.0, 250.0, 640, 480)
ODD = CameraIntrinsics(300.0, 340.0, 170.0, 105.0, 320, 240)
CENTRED = CameraIntrinsics(262.5, 262.5, 159.5, 119.5, 320, 240)
NO_LINES = DirectionsConfig(gravity=False, orient_planes=False)
MEASURED = Config(depth=DepthConfig(source='topic'))
SIZE_M = np.array([4.0, 5.0, 2.5])


def corner(camera, noise=0.0, seed=0):
    """Return a view into the corner of a room, and its depth with noise."""
    scene = render(box(SIZE_M / 2, SIZE_M), camera_rotation(35, -25, 8),
                   np.array([2.0, 2.5, 1.4]), camera, np.random.default_rng(0))
    return scene, with_disparity_noise(scene.depth_m, noise, np.random.default_rng(seed))


def pairs(truth_labels, found_labels, least_iou=0.8):
    """Yield the indices of each large region of an image and of the one that covers it."""
    iou = overlap(truth_labels, found_labels, np.ones(truth_labels.shape, bool)).iou
    shares = np.bincount(truth_labels[truth_labels >= 0], minlength=len(iou)) / truth_labels.size
    for i in np.flatnonzero(shares > 0.03):
        if iou[i].max(initial=0) > least_iou:
            yield i, int(iou[i].argmax())


# 1. Errors.


def test_stated_covariances_are_those_of_draws_with_all_correlations():
    """Of normal and offset, in every direction of the four."""
    camera, draws = LARGE, 60
    scene = corner(camera)[0]
    off, stated = {}, {}
    for seed in range(draws):
        found = segment_planes(corner(camera, 0.004, seed)[1], camera)
        for i, k in pairs(scene.labels, found.labels):
            plane = found.planes[k]
            off.setdefault(i, []).append([*plane.normal, plane.offset_m] - scene.planes[i])
            stated.setdefault(i, []).append(plane.covariance)
    assert len(off) >= 3
    for i, errors in off.items():
        assert len(errors) > 0.9 * draws
        spread, mean = np.cov(np.array(errors).T), np.mean(stated[i], axis=0)
        across = np.linalg.svd(scene.planes[i][None, :3])[2][1:]
        basis = np.zeros((3, 4))
        basis[:2, :3], basis[2, 3] = across, 1
        spread, mean = (basis @ one @ basis.T for one in (spread, mean))
        ratios = np.sqrt(np.diag(spread) / np.diag(mean))
        assert ((ratios > 0.65) & (ratios < 1.5)).all(), (i, ratios)
        correlations = [one / np.sqrt(np.outer(np.diag(one), np.diag(one)))
                        for one in (spread, mean)]
        np.testing.assert_allclose(*correlations, atol=0.2)
        # Which combinations are known best and worst, whatever the axes.
        whole = np.linalg.eigvals(np.linalg.solve(mean, spread)).real
        assert (whole > 0.4).all() and (whole < 2.6).all(), (i, whole)


def test_planes_that_are_moved_have_the_points_and_the_errors_of_before():
    """By points: three of each plane are moved, and the plane through them is computed anew."""
    rng = np.random.default_rng(0)
    half = rng.normal(0, 0.01, (4, 4))
    plane = Plane(np.array([0.6, 0.0, -0.8]), 1.5, np.array([0.3, -0.2, 2.1]), 120, 0.002, 0.7,
                  half @ half.T, 0.9, label=3, merged=2)
    turn = RigidTransform.from_quaternion((0.3, -0.2, 0.5, 0.7), (0.4, -1.2, 0.8))
    scale = 2.5
    moved = Planes.of([plane]).moved(PlaneMotion(turn.rotation, turn.translation_m, scale), scale)

    def through(coefficients):
        """Return the plane through the moved points of a plane n . p + d = 0."""
        normal, offset = coefficients[:3], coefficients[3]
        length = np.linalg.norm(normal)
        aside = np.linalg.svd(normal[None])[2][1:]
        points = -offset / length**2 * normal + np.vstack([np.zeros(3), aside])
        points = scale * points @ turn.rotation.T + turn.translation_m
        new = turn.rotation @ normal  # to the side where the camera was
        return np.append(new, -new @ points.mean(axis=0)), points

    before = np.append(plane.normal, plane.offset_m)
    after, points = through(before)
    assert abs(points @ moved.normals[0] + moved.offsets_m[0]).max() < 1e-12
    assert moved.normals[0] == pytest.approx(after[:3])
    assert moved.centroids_m[0] == pytest.approx(
        scale * turn.rotation @ plane.centroid_m + turn.translation_m)
    jacobian = np.column_stack([(through(before + 1e-6 * e)[0] - after) / 1e-6 for e in np.eye(4)])
    # The offset is in lengths of after; the normal has none.
    np.testing.assert_allclose(moved.covariances[0], jacobian @ plane.covariance @ jacobian.T,
                               rtol=1e-3, atol=1e-9)
    assert (moved.rms_m[0], moved.areas_m2[0]) == pytest.approx((0.005, 0.7 * 6.25))
    for name in ('counts', 'confidences', 'labels', 'merged', 'classes'):
        assert getattr(moved, name)[0] == getattr(Planes.of([plane]), name)[0]


# 2. Units.


def test_sums_over_cells_in_another_unit_are_those_of_the_image_in_it():
    rng = np.random.default_rng(0)
    v, u = np.mgrid[:60, :80]
    disparity = (0.5 + 0.004 * u + 0.002 * v + rng.normal(0, 0.01, u.shape)).astype(np.float32)
    valid = rng.random(u.shape) < 0.95
    disparity[~valid] = 0
    scale, shift = 3.0, 0.4
    grid = build_cell_grid(DisparityImage(disparity, valid), 4)
    regions = PixelRegions(disparity, np.zeros(u.shape, np.int32), np.array([[0.3, 0.1, 0.7]]),
                           grid, Noise(0.01, 0.02, 0.03)).rescaled(scale, shift)
    other = np.where(valid, scale * disparity + shift, 0).astype(np.float32)
    expected = build_cell_grid(DisparityImage(other, valid), 4)
    for name in ('moments', 'mean', 'slope', 'residual_rms', 'usable', 'sparsity', 'lens'):
        np.testing.assert_allclose(getattr(regions.grid, name), getattr(expected, name),
                                   rtol=2e-4, atol=2e-4, err_msg=name)
    assert regions.coefficients[0] == pytest.approx([0.9, 0.3, 2.5])


def network(values, output, noise_share=0.0):
    return DepthFunction(lambda rgb: values, output, noise_share)


@pytest.mark.parametrize('noise_share', [0.0, 0.03])
def test_a_disparity_of_known_scale_gives_planes_as_its_metres_do(noise_share):
    """All fields: a unit changes neither pixels nor errors."""
    scene, depth_m = corner(ODD, 0.003)
    scale, shift = 0.4, -0.05
    relative = (1 / depth_m - shift) / scale
    fixed = Config(directions=NO_LINES, scale=ScaleConfig(
        method='fixed', disparity_scale=scale, disparity_shift=shift))
    plain = Config(directions=NO_LINES)
    one = PlaneDetector(fixed, network(relative, 'relative_disparity', noise_share)).detect(
        scene.rgb, ODD)
    other = PlaneDetector(plain, network(1 / depth_m, 'disparity', noise_share)).detect(
        scene.rgb, ODD)
    matched = list(pairs(other.labels, one.labels))
    assert len(matched) >= 3
    for i, k in matched:
        expected, found = other.planes[i], one.planes[k]
        assert angle_deg(found.normal, expected.normal) < 0.2
        assert found.centroid_m == pytest.approx(expected.centroid_m, abs=0.02)
        for name in ('offset_m', 'area_m2', 'rms_m', 'inlier_count', 'confidence'):
            assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=0.06), name
        np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)),
                                   np.sqrt(np.diag(expected.covariance)), rtol=0.3)


def test_what_is_too_far_once_its_scale_is_known_belongs_to_no_plane():
    """A floor to the horizon, of which depth.max_depth leaves the first six metres."""
    scene = render([rectangle((-40, -40, 0), (80, 0, 0), (0, 80, 0))], camera_rotation(0, -15, 0),
                   np.array([0, 0, 1.2]), ODD, np.random.default_rng(0))
    values = np.nan_to_num((1 / scene.depth_m + 0.1) / 0.4, nan=0.26).astype(np.float32)
    config = Config(depth=DepthConfig(max_depth=6.0), directions=NO_LINES, scale=ScaleConfig(
        method='fixed', disparity_scale=0.4, disparity_shift=-0.1))
    found = PlaneDetector(config, network(values, 'relative_disparity')).detect(scene.rgb, ODD)
    is_near = scene.depth_m < 6.0
    assert 0.2 < is_near.mean() < 0.9
    assert (found.labels[~is_near] == -1).all()
    floor = found.planes[0]
    assert floor.inlier_count == pytest.approx(is_near.sum(), rel=0.02)
    assert floor.centroid_m[2] < 6.0
    area_m2 = np.nansum(np.where(is_near, scene.depth_m**3, 0)) / (ODD.fx * ODD.fy * 1.2)
    assert floor.area_m2 == pytest.approx(area_m2, rel=0.05)


# 3. The same scene seen otherwise.


def mirrored(camera):
    return replace(camera, cx=camera.width - 1 - camera.cx)


def upside_down(camera):
    return replace(camera, cy=camera.height - 1 - camera.cy)


def transposed(camera):
    return CameraIntrinsics(camera.fy, camera.fx, camera.cy, camera.cx, camera.height,
                            camera.width)


VIEWS = {
    'mirrored': (lambda a: a[:, ::-1], mirrored, np.diag([-1.0, 1, 1])),
    'upside down': (lambda a: a[::-1], upside_down, np.diag([1.0, -1, 1])),
    'transposed': (lambda a: a.swapaxes(0, 1), transposed, np.eye(3)[[1, 0, 2]])}


@pytest.mark.parametrize('name', VIEWS)
@pytest.mark.parametrize('seed', [11, 14])
def test_the_same_scene_seen_otherwise_has_the_same_planes(name, seed):
    """Normals, offsets, centroids, areas, errors, classes, ground, heights, all in its frame."""
    change, camera_of, turn = VIEWS[name]
    scene = random_room(np.random.default_rng(seed), ODD)
    depth_m = with_disparity_noise(scene.depth_m, 0.003, np.random.default_rng(seed))
    one = PlaneDetector(MEASURED).detect(scene.rgb, ODD, depth_m, scene.gravity_camera)
    other = PlaneDetector(MEASURED).detect(
        np.ascontiguousarray(change(scene.rgb)), camera_of(ODD),
        np.ascontiguousarray(change(depth_m)), turn @ scene.gravity_camera)
    matched = list(pairs(np.ascontiguousarray(change(one.labels)), other.labels, 0.93))
    assert len(matched) >= 3
    whole = np.eye(4)
    whole[:3, :3] = turn
    for i, k in matched:
        expected, found = one.planes[i], other.planes[k]
        sigma_deg = np.degrees(np.sqrt(np.trace(expected.covariance[:3, :3])))
        assert angle_deg(found.normal, turn @ expected.normal) < 0.3 + sigma_deg
        assert found.offset_m == pytest.approx(expected.offset_m, rel=0.01)
        assert found.centroid_m == pytest.approx(turn @ expected.centroid_m, abs=0.1)
        assert found.area_m2 == pytest.approx(expected.area_m2, rel=0.12)
        assert found.plane_class == expected.plane_class
        covariance = whole @ expected.covariance @ whole.T
        assert np.linalg.norm(found.covariance - covariance) < 0.5 * np.linalg.norm(covariance)
    assert other.camera_height_m == pytest.approx(one.camera_height_m, abs=0.02)
    assert other.tilt_deg == pytest.approx(one.tilt_deg, abs=0.3)
    for mask in ('ground', 'obstacles'):
        assert (getattr(other, mask) == change(getattr(one, mask))).mean() > 0.93, mask
    one, other = one.ground_result, other.ground_result
    both = np.isfinite(other.heights_m) & np.isfinite(change(one.heights_m))
    assert both.mean() > 0.5
    off_m = abs(other.heights_m - change(one.heights_m))[both]
    assert np.quantile(off_m, 0.9) < 0.03
    sigmas = (other.height_sigmas_m / change(one.height_sigmas_m))[both]
    assert np.nanquantile(sigmas, [0.1, 0.9]) == pytest.approx([1, 1], abs=0.3)


def test_a_scene_twice_as_large_has_planes_twice_as_far():
    scene, depth_m = corner(ODD, 0.004)
    one, other = (segment_planes(scale * depth_m, ODD) for scale in (1, 2))
    expected = one.planes.moved(RigidTransform.identity(), 2.0)
    matched = list(pairs(one.labels, other.labels))
    assert len(matched) >= 3
    for i, k in matched:
        assert angle_deg(other.planes[k].normal, expected[i].normal) < 0.1
        for name in ('offset_m', 'area_m2', 'rms_m', 'inlier_count'):
            assert getattr(other.planes[k], name) == pytest.approx(
                getattr(expected[i], name), rel=0.03), name
        np.testing.assert_allclose(other.planes[k].covariance, expected[i].covariance,
                                   rtol=0.2, atol=0.1 * np.abs(expected[i].covariance).min())


def test_heights_are_those_of_the_world_for_a_camera_that_is_rolled():
    things = [box(np.array([x, 2.2, 0.15]), np.array([0.4, 0.4, 0.3])) for x in (-0.7, 0.6)]
    faces = [rectangle((-9, -9, 0), (18, 0, 0), (0, 18, 0)), *sum(things, [])]
    rotation = camera_rotation(5, -28, 25)
    scene = render(faces, rotation, np.array([0, 0, 1.1]), ODD, np.random.default_rng(0))
    depth_m = with_disparity_noise(scene.depth_m, 0.001, np.random.default_rng(1))
    found = PlaneDetector(MEASURED).detect(scene.rgb, ODD, depth_m, scene.gravity_camera)
    v, u = np.indices(depth_m.shape)
    rays = np.stack([(u - ODD.cx) / ODD.fx, (v - ODD.cy) / ODD.fy, np.ones(u.shape)], axis=-1)
    z_m = (scene.depth_m[..., None] * rays) @ rotation[2] + 1.1
    is_near = scene.depth_m < 4
    heights_m = found.ground_result.heights_m
    off_m = (heights_m - z_m)[is_near & np.isfinite(heights_m)]
    assert len(off_m) > 0.5 * z_m.size
    assert np.quantile(np.abs(off_m), 0.95) < 0.02
    is_box = is_near & (z_m > 0.1)
    assert found.obstacles[is_box].mean() > 0.95
    is_floor = is_near & (z_m < 0.005)
    assert found.ground[is_floor].mean() > 0.95
    assert found.camera_height_m == pytest.approx(1.1, abs=0.01)
    assert found.tilt_deg == pytest.approx(28, abs=0.5)


# 4. The noise of cells.


@pytest.mark.parametrize('lateral_px', [0.3, 0.6])
def test_the_lateral_noise_of_a_cell_averages_out_as_its_pixels_do(lateral_px):
    """The mean of a cell on a slope varies by as much as stated, over 200 draws."""
    rng, grids = np.random.default_rng(0), []
    v, u = np.mgrid[:64, :96].astype(float)
    for _ in range(200):
        moved = u + lateral_px * rng.standard_normal(u.shape)
        values = (0.4 + 0.01 * moved + 0.001 * v).astype(np.float32)
        grids.append(build_cell_grid(DisparityImage(values, np.ones(u.shape, bool)), 8))
    spread = np.std([grid.mean[:, 2] for grid in grids], axis=0)
    stated = weigh_cells(grids[0], Noise(0.0, 0.0, 0.0, lateral_px=lateral_px)
                         ).table[:, MEAN_WEIGHT] ** -0.5
    assert np.median(spread / stated) == pytest.approx(1.0, abs=0.15)


# 5. The error of the shift.


def test_an_uncertain_shift_lets_lines_turn_planes_back(monkeypatch):
    """Of exact depth whose shift is off by as much as stated: only the lines can tell."""
    estimate, off_deg = network_steps.estimate_scale, []

    def off(evidence, config):
        found = estimate(evidence, config)
        return replace(found, shift=found.shift + 0.02, angle_sigma_deg=4.0)
    monkeypatch.setattr(network_steps, 'estimate_scale', off)
    for seed in (300, 301, 303, 306):
        scene = textured(random_room, seed, CENTRED)
        relative = ((1 / scene.depth_m + 0.1) / 0.4).astype(np.float32)
        config = Config(scale=ScaleConfig(
            camera_height=scene.height_m, gravity=tuple(scene.gravity_camera),
            gravity_tolerance=3.0))
        found = PlaneDetector(config, network(relative, 'relative_disparity')).detect(
            scene.rgb, CENTRED)
        off_deg.append(np.mean([angle_deg(found.planes[k].normal, scene.planes[i, :3])
                                for i, k in pairs(scene.labels, found.labels, 0.5)]))
    assert np.mean(off_deg) < 1.2
