# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The share of a large plane in one predicted plane, on synthetic depth."""

import numpy as np
import pytest

from plane_detector.evaluation.benchmark.fragmentation import held_and_holdable
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics.from_field_of_view(160, 120, 60.0)
NOISE = 0.01
WHOLE, HALVES = np.zeros((120, 160), int), np.zeros((120, 160), int)
HALVES[:, 40:] = 1


def shares(sensor, labels, depth_m):
    return list(held_and_holdable(sensor, labels, depth_m, CAMERA, NOISE,
                                  np.random.default_rng(0)))


def tilted(scale=1.0):
    """Return the depth of a plane that is tilted, 1/z times so much."""
    u = np.arange(160) / 160
    return np.broadcast_to(1 / (scale * (0.3 + 0.4 * u)), (120, 160)).copy()


def test_a_plane_in_one_piece():
    assert shares(WHOLE, WHOLE, tilted()) == [(1.0, 1.0)]


def test_many_pieces_on_depth_of_one_plane():
    assert shares(WHOLE, HALVES, tilted()) == [(0.75, 1.0)]


@pytest.mark.parametrize(('step', 'holdable'), [(0.5, 1.0), (5, 1.0), (9, 0.75)])
def test_depth_with_a_step_fits_one_plane_within_six_deviations(step, holdable):
    """A plane between both sides is within three of each."""
    disparity = 1 / tilted()
    disparity[:, 40:] += step * NOISE
    (held, most), = shares(WHOLE, HALVES, 1 / disparity)
    assert held == 0.75
    assert most == pytest.approx(holdable, abs=0.06)


def test_small_planes_and_pixels_without_depth_do_not_count():
    sensor = WHOLE.copy()
    sensor[:, 80:] = -1
    sensor[:8, 100:] = 1
    depth_m = tilted()
    depth_m[::2, :80] = np.nan
    labels = WHOLE.copy()
    labels[60:] = -1
    assert shares(sensor, labels, depth_m) == [(0.5, 1.0)]
    assert shares(np.full_like(WHOLE, -1), WHOLE, tilted()) == []
