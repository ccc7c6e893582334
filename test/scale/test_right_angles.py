# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of the shift by known directions."""

import numpy as np
import pytest

from plane_detector.scale.disparity_planes import DisparityPlanes
from plane_detector.scale.right_angles import estimate_shift

DOWN = np.array([0.05, 0.95, 0.3]) / np.linalg.norm([0.05, 0.95, 0.3])
ACROSS = np.cross(DOWN, [0.3, 0.0, 1.0])
ACROSS /= np.linalg.norm(ACROSS)
AXES = np.stack([DOWN, ACROSS, np.cross(DOWN, ACROSS)])
TAU = 0.7


def planes(normals, offsets, shares, tau=TAU):
    """Return planes -n / d of 1/z in a disparity without the shift tau."""
    coefficients = -np.asarray(normals) / np.asarray(offsets)[:, None] - [0, 0, tau]
    count = len(coefficients)
    return DisparityPlanes(coefficients, np.tile(1e6 * np.eye(3), (count, 1, 1)),
                           np.zeros((count, 2)), np.asarray(shares, float), np.arange(count))


def azimuth(angle_deg):
    angle = np.radians(angle_deg)
    return np.cos(angle) * AXES[1] + np.sin(angle) * AXES[2]


def test_exact_planes_give_the_exact_shift():
    found = estimate_shift(planes([-DOWN, -AXES[2], AXES[1]], [1.5, 4.0, 2.0], [0.4, 0.4, 0.2]),
                           -0.5, AXES)
    assert found.tau == pytest.approx(TAU, abs=1e-9)
    assert not found.refusal
    # Right angles of buildings are accurate to a degree: so is each plane at this sigma.
    raw = -DOWN / 1.5
    turned = raw + [0, 0, found.sigma]
    cosine = raw @ turned / np.linalg.norm(raw) / np.linalg.norm(turned)
    assert 0.1 < np.degrees(np.arccos(cosine)) < 1.0


def test_furniture_does_not_change_the_shift():
    slanted = -(DOWN + AXES[2] + 0.3 * AXES[1])
    found = estimate_shift(
        planes([-DOWN, -AXES[2], AXES[1], slanted / np.linalg.norm(slanted)],
               [1.5, 4.0, 2.0, 1.8], [0.35, 0.25, 0.15, 0.25]), -0.5, AXES)
    assert found.tau == pytest.approx(TAU, abs=1e-6)


def test_gravity_suffices_for_a_floor_and_walls_of_any_azimuth():
    found = estimate_shift(planes([-DOWN, -azimuth(20), -azimuth(80)], [1.5, 4.0, 2.0],
                                  [0.4, 0.3, 0.3]), -0.5, AXES[:1])
    assert found.tau == pytest.approx(TAU, abs=1e-6)


def test_planes_that_do_not_agree_are_refused():
    rng = np.random.default_rng(0)
    normals = rng.normal(0, 1, (6, 3)) - [0, 0, 2]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert estimate_shift(planes(normals, np.full(6, 2.0), np.full(6, 1 / 6)), -0.5,
                          AXES).refusal


def test_noise_shows_in_the_sigma():
    rng = np.random.default_rng(1)
    exact = planes([-DOWN, -AXES[2], AXES[1]], [1.5, 4.0, 2.0], [0.4, 0.4, 0.2])
    noisy = DisparityPlanes(exact.coefficients + rng.normal(0, 0.01, (3, 3)), exact.information,
                            exact.centers, exact.pixel_share, exact.labels)
    found = estimate_shift(noisy, -0.5, AXES)
    assert abs(found.tau - TAU) < 5 * found.sigma
    assert found.sigma > 1e-4
