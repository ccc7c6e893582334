# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of the posterior of the shift."""

import numpy as np
import pytest

from plane_detector.scale.disparity_planes import DisparityPlanes
from plane_detector.scale.shift_posterior import estimate_shift, frames_about

DOWN = np.array([0.05, 0.95, 0.3]) / np.linalg.norm([0.05, 0.95, 0.3])
ACROSS = np.cross(DOWN, [0.3, 0.0, 1.0])
ACROSS /= np.linalg.norm(ACROSS)
AXES = np.stack([DOWN, ACROSS, np.cross(DOWN, ACROSS)])
TAU = 0.7
# Inverse depths from .2 to .6, in the disparity without the shift.
LOWEST, SPAN = 0.18 - TAU, (0.2 - TAU, 0.35 - TAU, 0.6 - TAU)
FLOOR, WALLS = -DOWN, -AXES[1:] * np.sign(AXES[1:, 2:])


def planes(normals, offsets, shares, error_rad=0.0, seed=0):
    """Return planes -n / d of 1/z in a disparity without the shift, with errors of the slopes."""
    rng = np.random.default_rng(seed)
    coefficients = -np.asarray(normals) / np.asarray(offsets)[:, None]
    places = np.stack(np.meshgrid([-0.3, 0.0, 0.3], [-0.3, 0.0, 0.3]), axis=-1).reshape(-1, 2)
    seen = coefficients[:, :2] @ places.T + coefficients[:, 2:]
    middle = np.abs(seen - 0.35).argmin(1)
    centers, inverse = places[middle], seen[np.arange(len(seen)), middle]
    slopes = coefficients[:, :2] + error_rad * inverse[:, None] * rng.standard_normal(
        (len(centers), 2))
    constant = inverse - (slopes * centers).sum(1) - TAU
    count = len(coefficients)
    return DisparityPlanes(np.column_stack([slopes, constant]),
                           np.tile(1e6 * np.eye(3), (count, 1, 1)), centers,
                           np.asarray(shares, float), np.arange(count))


def room(error_rad=0.0, seed=0):
    return planes([FLOOR, *WALLS], [1.5, 4.0, 2.0], [0.4, 0.4, 0.2], error_rad, seed)


def found(given, tolerance_deg=2.0, axes=AXES[1:], down=DOWN):
    return estimate_shift(given, LOWEST, SPAN,
                          frames_about(down, np.radians(tolerance_deg / 2), axes))


def turned_deg(given, tau):
    raw, true = (given.coefficients + [0, 0, shift] for shift in (tau, TAU))
    cosine = (raw * true).sum(1) / np.linalg.norm(raw, axis=1) / np.linalg.norm(true, axis=1)
    return np.sqrt(given.pixel_share @ np.degrees(np.arccos(cosine.clip(-1, 1))) ** 2)


def test_exact_planes_give_the_shift():
    answer = found(room(), 0.2)
    assert turned_deg(room(), answer.tau) < 0.3
    assert answer.angle_sigma_deg < 1.0
    assert answer.note == '40% level, 60% upright'


@pytest.mark.parametrize('order', [[0, 1, 2], [1, 2, 0], [2, 0, 1]])
def test_axes_give_the_shift_whichever_is_named_first(order):
    """No axis is known to be the vertical: one cannot know which planes are level."""
    axes = AXES[order]
    frames = [frame for k in range(3)
              for frame in frames_about(axes[k], np.radians(0.1), np.delete(axes, k, axis=0))]
    answer = estimate_shift(room(), LOWEST, SPAN, frames)
    assert turned_deg(room(), answer.tau) < 0.3
    assert answer.note == '100% across one of the axes'


def test_floor_and_vertical_are_enough():
    floor = planes([FLOOR], [1.5], [1.0])
    assert turned_deg(floor, found(floor, axes=np.zeros((0, 3))).tau) < 2.0


def test_walls_and_a_vertical_that_is_not_level_are_enough():
    down = np.array([0.0, 0.8, 0.6])
    level = np.stack([np.cross(down, [0, 0, 1.0]), np.cross(down, [1.0, 0, 0])])
    level /= np.linalg.norm(level, axis=1, keepdims=True)
    azimuths = [np.cos(a) * level[1] + np.sin(a) * level[0] for a in (-0.9, 0.5)]
    walls = planes([n * -np.sign(n[2]) for n in azimuths], [2.0, 3.0], [0.5, 0.5])
    assert turned_deg(walls, found(walls, axes=np.zeros((0, 3)), down=down).tau) < 3.0


def test_furniture_hardly_changes_the_shift():
    slanted = FLOOR + WALLS[0] + 0.3 * WALLS[1]
    given = planes([FLOOR, *WALLS, slanted / np.linalg.norm(slanted)], [1.5, 4.0, 2.0, 1.8],
                   [0.35, 0.25, 0.15, 0.25])
    assert turned_deg(given, found(given, 0.2).tau) < 1.0


def test_parallel_planes_ahead_do_not_make_a_flat_world():
    normals = np.array([[0.02, 0.3, -1.0], [0.0, 0.33, -1.0], [-0.05, 0.3, -1.0],
                        [0.04, 0.28, -1.0]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    shelf = planes(normals, [1.6, 2.0, 2.5, 3.5], [0.4, 0.3, 0.2, 0.1])
    answer = found(shelf)
    assert answer.refusal or turned_deg(shelf, answer.tau) < 3 * answer.angle_sigma_deg


def test_planes_in_another_unit_have_its_scale_and_shift():
    """1/z = 3 D + 0.3 at a pixel of the slopes .2 and -.1."""
    ray = np.array([0.2, -0.1, 1.0])
    assert room().scaled(3.0, 0.3) @ ray == pytest.approx(3 * (room().coefficients @ ray) + 0.3)


def test_angles_that_are_too_uncertain_are_refused():
    floor = planes([FLOOR], [1.5], [1.0])
    answer = found(floor, 10.0, axes=np.zeros((0, 3)))
    assert 'leave angles uncertain by 6 degrees' in answer.refusal and np.isnan(answer.tau)


@pytest.mark.parametrize(('error_deg', 'least'), [(1.0, 0.25), (3.0, 0.6), (5.0, 0.6)])
def test_the_stated_uncertainty_of_angles_and_shift_is_calibrated(error_deg, least):
    ratios, scores = [], []
    for seed in range(60):
        given = room(np.radians(error_deg), seed)
        answer = found(given)
        if not answer.refusal:
            ratios.append(turned_deg(given, answer.tau) / answer.angle_sigma_deg)
            scores.append((answer.tau - TAU) / answer.sigma)
    assert len(ratios) >= 50
    # Small errors are covered by those of buildings; else a variance three times too large shows.
    assert least < np.sqrt(np.mean(np.square(ratios))) < 1.2
    assert np.mean(np.array(ratios) > 2) <= 0.05
    assert least < np.sqrt(np.mean(np.square(scores))) < 1.2
