# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Hand-made regions: which become one, and that merging them is exact."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from cell_helpers import EXACT, cell_model, fold, noisy, regions_of_labels, view, wall

from plane_detector import CameraIntrinsics, Config, segment_planes
from plane_detector.config import RansacConfig
from plane_detector.evaluation.datasets import labelled_frames
from plane_detector.evaluation.metrics import labelled_score
from plane_detector.evaluation.scenes.rendering import VGA
from plane_detector.segmentation.cells.model import PlaneRegions
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.regions.merging import (
    MAX_JOINT_VARIANCES,
    PLANE,
    OnePlane,
    merge_coplanar,
    misfits,
)
from plane_detector.segmentation.regions.region_graph import (
    BORDER_REACH_CELLS,
    RegionGraph,
    merge_pairs,
)

SIGMAS = (0.0, 0.004, 0.01)
JOINT = OnePlane(PLANE, MAX_JOINT_VARIANCES, min_pairs=0)


def stripes(shape, count):
    """Return labels of upright stripes of equal width."""
    return np.tile(np.arange(shape[1]) * count // shape[1], (shape[0], 1))


def noise_of(sigma):
    """Return what cells show of noise half of which is smooth."""
    part = sigma * np.sqrt(0.5)
    # Blurred with a Gaussian of 12 pixels it tilts by 1 / (12 sqrt(2)) of itself per pixel.
    return replace(EXACT, mean_sigma=part, slope_sigma=part * 640 / (12 * np.sqrt(2)),
                   pixel_sigma=part)


def noisy_model(scene, sigma):
    """Return the cells of a view under such noise, weighed by it."""
    return cell_model(noisy(scene, 0, sigma), noise_of(sigma))


def merged_regions(model, labels, sigma=0.0):
    """Return what hand-made regions are merged to."""
    regions = regions_of_labels(model, labels)
    correlation = Correlation.of(model, regions, noise_of(sigma)) if sigma else None
    merged = merge_coplanar(model, RegionGraph.of(model, regions), correlation)
    return PlaneRegions(merged.labels, merged.planes)


def two_walls(step_m):
    return view([wall(2, right_m=0), wall(2 + step_m, 0)])


@pytest.mark.parametrize('sigma', SIGMAS)
@pytest.mark.parametrize('count', [2, 5, 8])
def test_stripes_of_one_wall_become_one(sigma, count):
    model = noisy_model(view([wall(2.5)], angles_deg=(30, 0, 0)), sigma)
    result = merged_regions(model, stripes(model.grid.shape, count), sigma)
    assert (result.labels == 0).all()
    whole = regions_of_labels(model, np.zeros(model.grid.shape, int)).coefficients
    np.testing.assert_allclose(result.coefficients, whole, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(('step_m', 'sigma'), [(0.01, 0.0), (0.1, 0.004), (0.3, 0.01)])
@pytest.mark.parametrize('turned', [False, True])
def test_stripes_of_two_walls_become_two(step_m, sigma, turned):
    model = noisy_model(two_walls(step_m), sigma)
    labels = stripes(model.grid.shape, 8)
    # The numbers say nothing: neighbours need not be neighbours in number.
    labels = np.array([5, 2, 7, 0, 3, 6, 1, 4])[labels] if turned else labels
    result = merged_regions(model, labels, sigma)
    assert len(result.coefficients) == 2
    left = result.labels[0, 0]
    assert (result.labels[:, :40] == left).all() and (result.labels[:, 40:] == 1 - left).all()


@pytest.mark.parametrize(('distance_m', 'width', 'count'), [
    (2.5, 1, 1), (2.5, 9, 1), (2.0, 9, 1), (3.0, 9, 2)])
def test_pieces_are_one_plane_unless_something_farther_is_seen_between(distance_m, width, count):
    """One cell without a label, several, an object before the wall, a window in it."""
    edge_m = width / 2 * 8 * distance_m / 525
    scene = view([wall(2.5, right_m=-edge_m * 2.5 / distance_m),
                  wall(2.5, edge_m * 2.5 / distance_m), wall(distance_m, -edge_m, edge_m)])
    model = cell_model(scene.depth_m)
    labels = np.full(model.grid.shape, -1)
    labels[:, :40 - width // 2], labels[:, 40 + (width + 1) // 2:] = 0, 1
    assert len(merged_regions(model, labels).coefficients) == count


def test_a_round_corner_of_a_network_does_not_become_one_plane_by_many_small_steps():
    """Two walls; the normal turns by degrees from stripe to stripe of the corner between them."""
    ray = (np.arange(640) - VGA.cx) / VGA.fx
    slope = 0.4 * np.clip(ray / 0.4, -1, 1)
    disparity = np.cumsum(slope) / VGA.fx
    disparity += 0.4 - disparity.min()
    turn_deg = np.degrees(np.arctan2(slope, disparity - slope * ray)).reshape(16, -1).mean(1)
    model = cell_model(np.tile(1 / disparity, (480, 1)).astype(np.float32), noise_of(0.02))
    graph = RegionGraph.of(model, regions_of_labels(model, stripes(model.grid.shape, 16)))
    region = merge_coplanar(model, graph, None, max_fold_deg=20.0).labels[0, 2::5]
    spans_deg = [np.ptp(turn_deg[region == k]) for k in range(region.max() + 1)]
    assert max(spans_deg) < 21 and len(spans_deg) < 8 and np.ptp(turn_deg) > 100


def test_merged_regions_have_the_sums_of_all_their_cells():
    model = noisy_model(view([wall(2.5)]), 0.004)
    regions = regions_of_labels(model, labels := stripes(model.grid.shape, 8))
    graph = RegionGraph.of(model, regions)
    given = [part.copy() for part in vars(graph).values()]
    pairs = iter([(0, 1), (4, 7), (0, 2)])

    def misfit(graph):
        cost = np.full((8, 8), np.inf)
        for pair in islice(pairs, 1):
            cost[pair] = 0
        return cost

    result = merge_pairs(graph, misfit, lambda *_: False)
    for part, before in zip(vars(graph).values(), given, strict=True):
        np.testing.assert_array_equal(part, before)
    np.testing.assert_array_equal(result.owner, [0, 0, 0, 3, 4, 5, 6, 4])
    joined = np.array([0, 0, 0, 3, 4, 5, 6, 4])[labels]
    expected = RegionGraph.of(model, regions_of_labels(model, joined))
    left = [0, 3, 4, 5, 6]
    for name in ('pixels', 'sums'):
        np.testing.assert_allclose(getattr(result, name)[left], getattr(expected, name)[left],
                                   rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(result.borders[np.ix_(left, left)],
                               expected.borders[np.ix_(left, left)], rtol=1e-9, atol=1e-9)
    assert (result.sums[[1, 2, 7]] == 0).all()
    merged = result.without_merged()
    np.testing.assert_array_equal(merged.labels, np.array([0, 0, 0, 1, 2, 3, 4, 2])[labels])
    refitted = regions_of_labels(model, merged.labels).coefficients
    np.testing.assert_allclose(merged.planes[[0, 2]], refitted[[0, 2]], rtol=1e-9)
    np.testing.assert_array_equal(merged.planes[[1, 3, 4]],
                                  regions.coefficients[[3, 5, 6]])


def test_misfits_that_are_no_numbers_end_the_merging():
    model = noisy_model(view([wall(2.5)]), 0.004)
    graph = RegionGraph.of(model, regions_of_labels(model, stripes(model.grid.shape, 3)))
    calls = []

    def misfit(found):
        calls.append(1)
        assert len(calls) < 10, 'it goes on'
        return np.full((len(found.planes),) * 2, np.nan)
    np.testing.assert_array_equal(merge_pairs(graph, misfit, lambda *_: False).labels,
                                  graph.labels)


def test_joint_misfit_by_hand():
    """The worse side's mean square about the joint plane, in variances, over the most."""
    model = noisy_model(two_walls(0.05), 0.004)
    regions = regions_of_labels(model, stripes(model.grid.shape, 2))
    x, y, d = model.grid.mean[model.is_planar].T
    design = np.stack([x, y, np.ones_like(x)], axis=1)
    error = d - design @ np.linalg.lstsq(design, d, rcond=None)[0]
    label = regions.labels.ravel()[model.is_planar]
    variance = 1 / model.table[model.is_planar, 5]
    worse = max(np.mean(error[label == k]**2) / variance[label == k].mean() for k in (0, 1))
    misfit = misfits(RegionGraph.of(model, regions), JOINT)
    assert misfit[0, 1] == pytest.approx(worse / MAX_JOINT_VARIANCES, rel=1e-3)
    assert np.isinf(misfit[[0, 1, 1], [0, 1, 0]]).all()


def test_adjacency_equals_a_loop_over_pairs_of_cells():
    model = cell_model(view([wall(2.5)]).depth_m)
    labels = np.random.default_rng(0).integers(-1, 5, model.grid.shape).astype(np.int32)
    mean = model.grid.mean.reshape(*labels.shape, 3)
    pairs = {}
    for row, column in np.ndindex(labels.shape):
        for gap in range(1, BORDER_REACH_CELLS + 1):
            for other in ((row + gap, column), (row, column + gap)):
                if other[0] < labels.shape[0] and other[1] < labels.shape[1]:
                    ends = sorted([(row, column), other], key=lambda at: labels[at])
                    if 0 <= labels[ends[0]] < labels[ends[1]]:
                        key = labels[ends[0]], labels[ends[1]]
                        pairs.setdefault(key, []).append([mean[end] for end in ends])
    found = RegionGraph.of(model, regions_of_labels(model, labels)).borders
    assert sorted(pairs) == list(zip(*np.nonzero(np.triu(found[:, :, 0])), strict=True))
    for (i, j), ends in pairs.items():
        assert found[i, j, 0] == found[j, i, 0] == len(ends)
        np.testing.assert_allclose([found[i, j, 1:4], found[j, i, 1:4]], np.sum(ends, axis=0))
        x, y = np.mean(ends, axis=1)[:, :2].T
        np.testing.assert_allclose([found[i, j, 4:], found[j, i, 4:]],
                                   [[x @ x, x @ y, y @ y]] * 2)


CAMERA = CameraIntrinsics.from_field_of_view(320, 240, 60.0)
DIPPED = view(fold(3), intrinsics=CAMERA)
STEP = view([wall(2.0, right_m=0), wall(2.01, 0)], intrinsics=CAMERA)


@pytest.mark.parametrize(('scene', 'distance_m', 'angle_deg', 'count'), [
    (DIPPED, 0.05, 4.0, 1), (DIPPED, 0.05, 2.0, 2), (DIPPED, 0.002, 4.0, 2),
    (DIPPED, 0.0, 4.0, 2), (STEP, 0.05, 4.0, 2)],
    ids=['flat enough', 'too steep', 'too far off', 'never', 'step'])
def test_a_surface_as_flat_as_the_user_tolerates_is_one_plane(scene, distance_m, angle_deg,
                                                              count):
    settings = replace(Config().segmentation, flatness_distance=distance_m,
                       flatness_angle=angle_deg)
    found = segment_planes(scene.depth_m, CAMERA, replace(Config(), segmentation=settings))
    assert len(found.planes) == count
    assert (found.labels >= 0).mean() > 0.99


@pytest.mark.parametrize('height', [0.06, 0.09])
@pytest.mark.parametrize('angles_deg', [(0, 0, 0), (30, 0, 0), (0, -50, 0)])
def test_a_wall_that_a_network_bows_is_one_plane(angles_deg, height):
    """Its disparity rises to the sides by so much per metre."""
    x = np.linspace(-1, 1, VGA.width)
    depth_m = 1 / (1 / view([wall(2)], angles_deg=angles_deg).depth_m + height * x * x)
    found = segment_planes(depth_m.astype(np.float32), VGA, disparity_noise=0.008)
    assert len(found.planes) == 1
    assert (found.labels == 0).mean() > 0.97


def test_pieces_of_two_planes_behind_an_object_stay_two(data_folder):
    # Four degrees apart. As one plane, the frame has SC .91 to .92.
    frame = next((one for one in labelled_frames(data_folder) if one.name == 'nyu0524'), None)
    if frame is None:
        pytest.skip('no frame nyu0524')
    known = (frame.labels >= 0) & np.isfinite(frame.depth_m)
    for seed in range(3):
        config = replace(Config(), ransac=RansacConfig(seed=seed))
        labels = segment_planes(frame.depth_m, frame.intrinsics, config).labels
        assert labelled_score(np.maximum(frame.labels, -1), labels, known)['SC'] > 0.93


@pytest.mark.parametrize('seed', [0, 1, 2])
@pytest.mark.parametrize('is_turned', [False, True])
def test_a_plate_tilted_along_its_border_is_not_merged_with_a_level_one(is_turned, seed):
    """Two plates of 30 x 25 cm, 1.3 m away; along their border the gap is 0 in the mean."""
    tilt_deg, camera = 3.0, CameraIntrinsics(525.0, 525.0, 319.5, 319.5, 640, 640)
    ray_x, ray_y = (np.arange(640) - 319.5)[None] / 525, (np.arange(640) - 319.5)[:, None] / 525
    is_right = np.broadcast_to(ray_x > 0, (640, 640))
    disparity = np.where(is_right, 1 - np.tan(np.radians(tilt_deg)) * ray_y, 1.0) / 1.3
    is_plate = (abs(ray_x) < 0.3 / 1.3) & (abs(ray_y) < 0.125 / 1.3)
    noise = np.random.default_rng(seed).normal(0, 3e-4, disparity.shape)
    depth_m = np.where(is_plate, 1 / (disparity + noise), np.nan).astype(np.float32)
    tilted = np.array([0.0, np.sin(np.radians(tilt_deg)), -np.cos(np.radians(tilt_deg))])
    if is_turned:
        depth_m, is_right, is_plate = depth_m.T.copy(), is_right.T, is_plate.T
        tilted = tilted[[1, 0, 2]]
    found = segment_planes(depth_m, camera)
    for part, normal in ((is_plate & is_right, tilted), (is_plate & ~is_right, [0.0, 0, -1])):
        k, count = np.unique(found.labels[part], return_counts=True)
        assert count.max() > 0.9 * part.sum()
        cosine = found.planes.normals[k[count.argmax()]] @ normal
        assert np.degrees(np.arccos(cosine)) < 0.5
