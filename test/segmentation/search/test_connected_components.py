# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Connected flat components: what links, what does not, and that nothing bent is called flat."""

import numpy as np
import pytest
from cell_helpers import EXACT, cell_model, disparity_image, rectangle, view, wall

from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rooms import VGA, bumps, staircase
from plane_detector.evaluation.scenes.surfaces import cone
from plane_detector.segmentation.cells.grid import N, build_cell_grid
from plane_detector.segmentation.cells.noise import estimate_noise
from plane_detector.segmentation.search.connected_components import (
    MAX_VARIANCES,
    planar_components,
)
from plane_detector.types import CameraIntrinsics

MIN_PIXELS, THRESHOLD = 1000, 3.0


def tiles(angle_deg):
    """Return two tiles that meet in a crease 2 m away, their normals that angle apart."""
    rise = 5 * np.tan(np.radians(angle_deg / 2))
    return view([rectangle([0, 2, -5], [x, rise, 0], [0, 0, 10]) for x in (-5, 5)])


def components(depth_m, noise=EXACT):
    """Return model and components, each a plane and its cells (R * C,) bool."""
    model = cell_model(depth_m, noise)
    found = planar_components(model, MIN_PIXELS, THRESHOLD)
    return model, [(plane, found.labels.ravel() == k)
                   for k, plane in enumerate(found.coefficients)]


def estimated(depth_m):
    """Return model and components as they are with the noise that the image shows."""
    return components(depth_m, estimate_noise(build_cell_grid(disparity_image(depth_m)), EXACT))


def true_plane(model, scene, label):
    """Return a, b, c of a true plane, from its normal and offset."""
    camera = scene.intrinsics
    a, b, c = -scene.planes[label, :3] / scene.planes[label, 3]
    x, y = a * camera.width / camera.fx, b * camera.width / camera.fy
    return np.array([x, y, c])


@pytest.mark.parametrize('angle_deg', [2, 5, 20, 60, 100])
def test_tiles_that_meet_in_a_crease_are_two(angle_deg):
    scene = tiles(angle_deg)
    model, found = components(scene.depth_m)
    assert len(found) == 2
    for plane, members in found:
        label = scene.labels[240, 100 if members.reshape(model.grid.shape)[30, 12] else 540]
        np.testing.assert_allclose(plane, true_plane(model, scene, label), atol=2e-4)
        assert members.sum() >= 0.97 * model.is_planar.sum() / 2


@pytest.mark.parametrize(('angle_deg', 'count'), [(0.2, 1), (0.7, 0)])
def test_what_bends_a_little_is_one_or_left_to_the_search(angle_deg, count):
    assert len(components(tiles(angle_deg).depth_m)[1]) == count


@pytest.mark.parametrize(('step_m', 'count'), [(0.0005, 1), (0.005, 2), (0.02, 2), (1.0, 2)])
@pytest.mark.parametrize('edge_px', [0, 3])
def test_a_step_separates(step_m, count, edge_px):
    edge_m = edge_px * 2 / 525
    scene = view([wall(2, right_m=edge_m), wall(2 + step_m, edge_m)])
    _, found = components(scene.depth_m)
    assert len(found) == count
    depths_m = sorted(1 / plane[2] for plane, _ in found)
    np.testing.assert_allclose(depths_m, [2, 2 + step_m][:count], atol=max(step_m / 2, 1e-4)
                               if count == 1 else 1e-5)


@pytest.mark.parametrize('sigma', [0.0, 0.001, 0.002, 0.004, 0.01, 0.03])
@pytest.mark.parametrize('seed', [3, 7])
def test_components_are_flat_apart_large_and_in_order(room, sigma, seed):
    depth_m = with_disparity_noise(room(seed).depth_m, sigma, np.random.default_rng(seed))
    model, found = estimated(depth_m)
    assert len(found) >= (5 if sigma <= 0.002 else 0)
    taken = np.zeros(len(model.is_planar), int)
    for plane, members in found:
        x, y, d = model.grid.mean[members].T
        error = d - plane @ np.array([x, y, np.ones_like(x)])
        assert np.mean(error**2) < MAX_VARIANCES * np.mean(1 / model.table[members, 5])
        assert model.is_planar[members].all()
        taken += members
    assert taken.max() <= 1
    pixels = [model.grid.moments[members, N].sum() for _, members in found]
    assert pixels == sorted(pixels, reverse=True)
    assert min(pixels, default=MIN_PIXELS) >= MIN_PIXELS


@pytest.mark.parametrize('sigma', [0.004, 0.01, 0.02])
def test_a_pillar_that_links_under_noise_is_no_plane(sigma):
    pillar = cone(1.0, 1.0, -3, 3).at(0, 3.0)
    scene = view([wall(4)], pillar.curved_pieces())
    round_px = (scene.labels < 0).ravel()
    depth_m = with_disparity_noise(scene.depth_m, sigma, np.random.default_rng(0))
    model, found = estimated(depth_m)
    whole = np.array([m.reshape(model.grid.shape).repeat(8, 0).repeat(8, 1).ravel()
                      for _, m in found]).reshape(-1, depth_m.size)
    assert not len(whole) or (whole & round_px).sum(axis=1).max() < 0.2 * round_px.sum()


def test_where_all_is_curved_nothing_is_found():
    assert components(bumps().depth_m)[1] == []


def test_every_tread_and_riser_of_stairs_is_a_component():
    scene = staircase()
    model, found = components(scene.depth_m)
    size = model.grid.size_px
    middle = scene.labels[size // 2::size, size // 2::size].ravel()
    owners = [np.bincount(middle[members] + 1).argmax() - 1 for _, members in found]
    assert len(set(owners)) == len(owners) >= 9


@pytest.mark.parametrize('depth', [np.nan, 0.0])
def test_without_depth_there_is_no_component(depth):
    small = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)
    for camera in (small, VGA):
        depth_m = np.full((camera.height, camera.width), depth, np.float32)
        assert components(depth_m)[1] == []
