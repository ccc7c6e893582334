# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of the vanishing directions on rendered rooms whose images show lines."""

import cv2
import numpy as np
import pytest

from plane_detector.directions.frames import fit_frame
from plane_detector.directions.likelihood import Evidence
from plane_detector.directions.line_segments import (
    detect_line_segments,
    reduced_grey,
    segments_from_pixels,
)
from plane_detector.directions.posterior import CELL_RAD, Posterior, collect_evidence
from plane_detector.directions.prior import Expected
from plane_detector.directions.surfaces import mean_normals, surface_normals
from plane_detector.directions.vanishing import _if_it_rises, find_directions
from plane_detector.evaluation.scenes.rendering import VGA
from plane_detector.evaluation.scenes.rooms import attic, hexagon_room, random_room
from plane_detector.evaluation.scenes.textures import clutter, ramp_room, rolled_room, textured

AIM_DEG = 0.3


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def angle_deg(a, b):
    return np.degrees(np.arccos(np.clip(np.abs(np.asarray(a) @ np.asarray(b)), 0, 1)))


def directions_of(rgb):
    return find_directions(detect_line_segments(reduced_grey(rgb), VGA))


def project(start, end):
    """Return segments between points (N, 3) of the camera frame."""
    ends = np.stack([start, end], axis=1)
    return ends[..., :2] / ends[..., 2:] * [VGA.fx, VGA.fy] + [VGA.cx, VGA.cy]


def lines_along(directions, count, rng):
    """Return so many segments in space along each direction, in front of the camera."""
    start = rng.uniform([-1.5, -1.0, 3.0], [1.5, 1.0, 6.0], (count * len(directions), 3))
    along = np.repeat(directions, count, axis=0)
    return segments_from_pixels(project(start, start + 0.8 * along), VGA)


def tilted_frame():
    down = np.array([0.1, 0.95, 0.3])
    down /= np.linalg.norm(down)
    x = np.cross(down, [0.4, 0, 1.0])
    x /= np.linalg.norm(x)
    return np.stack([down, x, np.cross(down, x)])


def test_exact_lines_give_exact_directions(rng):
    frame = tilted_frame()
    found = find_directions(lines_along(frame, 12, rng))
    assert angle_deg(found.gravity_camera, frame[0]) < 1e-3
    assert found.gravity_camera @ frame[0] > 0
    assert angle_deg(found.pairs[0], frame[1]).min() < 1e-3
    assert not found.refusal and not found.pair_refusal


def test_the_covariance_is_across_the_direction_and_positive(rng):
    found = find_directions(lines_along(tilted_frame(), 12, rng))
    down = found.gravity_camera
    assert down @ found.covariance @ down == pytest.approx(0, abs=1e-12)
    assert np.linalg.eigvalsh(found.covariance)[1] > 0


def test_the_covariance_of_a_fit_is_that_of_its_errors(rng):
    frame = tilted_frame()
    exact_px = lines_along(frame, 12, rng).ends_px
    fits = [fit_frame(segments_from_pixels(exact_px + rng.normal(0, 0.5, exact_px.shape), VGA),
                      frame) for _ in range(200)]
    turns = np.array([cv2.Rodrigues(fit.axes.T @ frame)[0].ravel() for fit in fits])
    stated = np.mean([np.diag(fit.covariance) for fit in fits], axis=0)
    assert (abs(np.log2((turns**2).mean(axis=0) / stated)) < 1).all()


def test_one_direction_alone_is_refused(rng):
    found = find_directions(lines_along(tilted_frame()[:1], 40, rng))
    assert found.gravity_camera is None and not len(found.pairs)
    assert 0.5 < found.probability < 0.9


@pytest.mark.parametrize(('off_deg', 'is_found'), [(3, True), (40, False)])
def test_one_direction_is_the_vertical_if_the_depth_is_along_it(rng, off_deg, is_found):
    down, x, y = tilted_frame()
    turn = cv2.Rodrigues(np.radians(off_deg) * y)[0]
    surface = np.vstack([np.tile(turn @ down, (400, 1)), np.tile(turn @ x, (600, 1))])
    surface += rng.normal(0, 0.2, surface.shape)  # as those of a network
    surface /= np.linalg.norm(surface, axis=1, keepdims=True)
    lines = lines_along(down[None], 40, rng)
    found = find_directions(lines, collect_evidence(lines, surface))
    assert (found.gravity_camera is not None) == is_found
    if is_found:
        assert angle_deg(found.gravity_camera, down) < 0.5


@pytest.mark.parametrize('seen', [slice(0, 1), slice(1, 3)], ids=['floor', 'walls'])
def test_a_floor_or_walls_in_the_depth_show_that_level_lines_are_level(seen):
    axes = tilted_frame()
    nothing, surfaces = (Evidence(np.zeros((0, 8)), normals, np.radians(3.5))
                         for normals in (axes[:0], axes[seen]))
    assert _if_it_rises(axes, nothing)[0] < 0.95
    share, found, rises = _if_it_rises(axes, surfaces)
    assert share > 0.99 and not rises
    np.testing.assert_array_equal(found, axes)


def test_a_mode_has_the_spread_of_its_verticals():
    angles = np.radians([-2.0, 2.0])
    downs = np.column_stack([np.zeros(2), np.cos(angles), np.sin(angles)])
    half = np.array([0.5, 0.5])
    modes = Posterior(downs, half, half, np.zeros((2, 3, 3))).modes(np.array([0.0, 1.0, 0.0]))
    spread = np.sqrt(np.diag(modes.covariances[0] - CELL_RAD**2 / 12 * np.eye(3)))
    np.testing.assert_allclose(spread, [0, 0, np.sin(angles[1])], atol=1e-3)
    assert modes.masses.tolist() == [1.0]


def test_normals_of_a_floor_in_the_depth():
    y = ((np.arange(VGA.height) - VGA.cy) / VGA.fy)[:, None]
    disparity = np.broadcast_to(np.where(y > 0.1, y / 1.5, np.nan), (VGA.height, VGA.width))
    normals = surface_normals(disparity, VGA)[0]
    assert np.mean(normals @ [0, 1, 0] > 0.999) > 0.25


def test_what_stands_before_a_floor_has_no_ceiling_at_its_lower_edge():
    column, row = np.meshgrid(np.arange(VGA.width), np.arange(VGA.height))
    x, y = (column - VGA.cx) / VGA.fx, (row - VGA.cy) / VGA.fy
    behind = np.maximum(1 / 4, y / 1.2)  # a wall at 4 m, the floor 1.2 m below the camera
    board = (np.abs(x) < 0.3) & (np.abs(y - 0.1) < 0.15)
    disparity = np.where(board, 1.0, behind)
    normals, is_step = surface_normals(disparity, VGA)
    floor, ahead = (normals @ axis > 0.99 for axis in ([0, 1, 0], [0, 0, 1]))
    assert floor.mean() > 0.15 and ahead.mean() > 0.5 and is_step.mean() < 0.2
    assert normals[~is_step, 1].min() > -0.2
    assert normals[is_step, 1].min() < -0.9


def test_a_normal_that_is_not_near_itself_does_not_keep_the_search_going():
    """As one whose length has lost its digits."""
    normals = np.concatenate([np.tile([0.0, 1.0, 0.0], (300, 1)), np.full((20, 3), 0.1)])
    assert len(mean_normals(normals)) < 5


def test_a_coarse_direction_determines_the_vertical_of_a_rolled_camera(rng):
    down, x, y = tilted_frame()
    segments = lines_along(np.stack([down, x, y]), 12, rng)
    found = find_directions(segments, expected=Expected(x))
    assert angle_deg(found.gravity_camera, x) < 1e-3


def bar(down, x, y):
    """Return the segments of one bar on the floor, between the two horizontal axes."""
    along = np.cos(np.radians(40)) * x + np.sin(np.radians(40)) * y
    start = 4.0 * np.array([0, 0, 1.0]) + 0.8 * down - 0.6 * along
    return np.concatenate([project(one, one + 0.3 * along) for one in (
        start + np.outer(np.arange(4) * 0.35, along), start + np.outer(
            np.arange(4) * 0.35, along) + 0.03 * np.cross(down, along))])


def test_axes_of_a_single_bar_are_refused(rng):
    down, x, y = tilted_frame()
    lines = np.concatenate([lines_along(down[None], 12, rng).ends_px, bar(down, x, y),
                            lines_along(x[None], 2, rng).ends_px])
    alone = find_directions(segments_from_pixels(lines, VGA), expected=Expected(down, 5.0))
    assert not len(alone.pairs) and 'azimuth' in alone.pair_refusal
    assert angle_deg(alone.gravity_camera, down) < 0.1


def test_a_vertical_whose_pitch_only_a_leaning_bar_shows_is_refused():
    """Vertical lines next to each other and lines parallel to the image show no pitch."""
    u, v = VGA.cx + np.linspace(-12, 12, 6), np.linspace(60, 420, 6)
    posts = [[[one, 180], [one, 300]] for one in u]
    shelves = [[[60, one], [240, one]] for one in v]
    lean = np.array([0.0, np.cos(np.radians(12)), np.sin(np.radians(12))])
    start = np.array([[1.5, -0.8, 4.0], [1.55, -0.8, 4.0]])
    lines = np.concatenate([posts, shelves, project(start, start + 1.6 * lean)])
    found = find_directions(segments_from_pixels(lines, VGA))
    assert found.gravity_camera is None and found.probability < 0.9


def test_two_pairs_about_one_vertical(rng):
    down, x, y = tilted_frame()
    turned = np.cos(np.radians(40)) * x + np.sin(np.radians(40)) * y
    found = find_directions(lines_along(np.stack([down, x, y, x, y, turned]), 10, rng))
    assert len(found.pairs) == 2
    assert angle_deg(found.pairs[0], x).min() < 0.1
    assert angle_deg(found.pairs[1], turned).min() < 0.1


@pytest.mark.parametrize(('make', 'seeds', 'least'), [
    (random_room, (300, 302), 2), (rolled_room, (300, 302, 305), 2), (attic, (300, 303), 2),
    (hexagon_room, (300, 302, 305), 2)], ids=['room', 'roll', 'attic', 'hexagon'])
def test_rendered_rooms(make, seeds, least):
    errors = []
    for seed in seeds:
        scene = textured(make, seed)
        found = directions_of(scene.rgb)
        if found.gravity_camera is not None:
            errors.append(angle_deg(found.gravity_camera, scene.gravity_camera))
    assert len(errors) >= least
    assert max(errors) < AIM_DEG


def test_a_sloped_floor_does_not_tilt_the_vertical():
    for seed in (300, 304):
        scene = textured(ramp_room, seed)
        assert angle_deg(directions_of(scene.rgb).gravity_camera, scene.gravity_camera) < AIM_DEG


def test_upright_edges_outvote_the_tiles_of_a_sloped_floor():
    scene = textured(ramp_room, 302)
    found = directions_of(scene.rgb)
    assert angle_deg(found.gravity_camera, scene.gravity_camera) < 1.0
    assert not len(found.pairs) and 'perpendicular' in found.pair_refusal


def test_a_roof_is_no_wall_of_a_camera_that_looks_down():
    found = directions_of(textured(attic, 323).rgb)
    assert found.gravity_camera is None and found.refusal


def test_twigs_few_lines_and_no_lines_are_refused(rng):
    for found in (*(directions_of(clutter(np.random.default_rng(seed))) for seed in range(3)),
                  find_directions(lines_along(tilted_frame(), 1, rng)),
                  directions_of(np.full((480, 640, 3), 90, np.uint8))):
        assert found.gravity_camera is None and found.probability < 0.9
        assert 'probability' in found.refusal


@pytest.mark.parametrize(('make', 'seed'), [(attic, 302), (hexagon_room, 303)])
def test_a_fit_that_leaves_its_mode_loses_its_probability(make, seed):
    """The segments turn these main modes, which have .9 of the mass, to wrong verticals."""
    scene = textured(make, seed)
    found = directions_of(scene.rgb)
    assert found.gravity_camera is None
    assert angle_deg(found.modes.downs[0], scene.gravity_camera) > 5.0
