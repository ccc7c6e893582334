# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The stated errors of scale and shift are those of draws; the prior is one of the world."""

import numpy as np
import pytest

from plane_detector.scale import shift_posterior
from plane_detector.scale.disparity_planes import DisparityPlanes
from plane_detector.scale.floor import fit_floor
from plane_detector.scale.shift_posterior import ShiftEstimate
from plane_detector.types import ScaleEstimate

SCALE, TAU, HEIGHT_M = 0.4, 0.7, 1.5
TOLERANCE_DEG = 4.0  # two standard deviations


def floor_ahead(down):
    """Return the floor below a camera as a plane of D, with 1/z = SCALE * (D + TAU)."""
    slopes = down / HEIGHT_M / SCALE - [0, 0, TAU]
    return DisparityPlanes(slopes[None], np.tile(1e6 * np.eye(3), (1, 1, 1)),
                           np.array([[0.15, 0.3]]), np.array([0.6]), np.array([0]))


def test_the_stated_error_of_depth_is_the_spread_at_the_far_end():
    """Of depth by scales and shifts that are drawn, at the least disparity of the span."""
    covariance = np.array([[4e-4, -1e-4], [-1e-4, 1e-4]])
    estimate = ScaleEstimate(0.5, 0.1, 'camera_height', True, True, np.nan, '', (0.2, 0.5, 1.0))
    scales, shifts = np.random.default_rng(0).multivariate_normal(
        [0.5, 0.1], covariance, 40_000).T
    far_m = 1 / (scales * 0.2 + shifts)
    assert estimate.with_covariance(covariance).uncertainty == pytest.approx(
        far_m.std() * 0.2, rel=0.05)  # at 5 m


@pytest.mark.parametrize('pitch_deg', [10.0, 35.0])
@pytest.mark.parametrize(('tau_sigma', 'turn_deg'), [(0.03, 0.0), (0.0, TOLERANCE_DEG / 2),
                                                     (0.03, TOLERANCE_DEG / 2)])
def test_scale_and_shift_by_the_floor_are_as_uncertain_as_stated(pitch_deg, tau_sigma, turn_deg):
    pitch = np.radians(pitch_deg)
    down = np.array([0.0, np.cos(pitch), np.sin(pitch)])
    planes, rng, scores, scales = floor_ahead(down), np.random.default_rng(0), [], []
    stated_sigma = max(tau_sigma, 1e-9)
    tolerance_deg = TOLERANCE_DEG if turn_deg else 1e-6
    for _ in range(300):
        tau = TAU + tau_sigma * rng.standard_normal()
        turned = down + np.radians(turn_deg) * rng.standard_normal(3)
        fit = fit_floor(planes, ShiftEstimate(tau, stated_sigma, 1.0, ''),
                        turned / np.linalg.norm(turned), tolerance_deg, HEIGHT_M)
        assert fit is not None
        scores.append((fit.scale - SCALE) / np.sqrt(fit.covariance[0, 0]))
        # At the near end of the image, where 1/z is 1.
        far = np.array([1 / SCALE - TAU, 1.0])
        off = (np.array([fit.scale, fit.shift]) - [SCALE, SCALE * TAU]) @ far
        scales.append(off / np.sqrt(far @ fit.covariance @ far))
    assert 0.7 < np.sqrt(np.mean(np.square(scores))) < 1.4
    assert 0.7 < np.sqrt(np.mean(np.square(scales))) < 1.4


def test_the_prior_of_a_shift_is_the_same_whatever_shifts_are_tried():
    """Of shifts on equal steps and on equal factors, as many lie below any one."""
    span = (0.2, 0.35, 0.6)
    below = []
    for tau in (np.linspace(-0.199, 8.0, 4000), np.geomspace(0.001, 8.2, 4000) - 0.2):
        mass = np.exp(shift_posterior._log_prior(tau, span))
        below.append(np.interp([0.0, 0.2, 1.0], tau, np.cumsum(mass / mass.sum())))
    assert below[0] == pytest.approx(below[1], abs=0.02)
    # Half of all scenes have their far tenth at less than so much of the inverse of the near one.
    tau = np.geomspace(0.001, 60.0, 8000) - 0.2
    mass = np.exp(shift_posterior._log_prior(tau, span))
    middle = np.interp(0.5, np.cumsum(mass / mass.sum()), tau)
    assert 0.3 < (span[0] + middle) / (span[2] + middle) < 0.6
