# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Ramps between two surfaces are no planes; walls seen nearly from the side are."""

import cv2
import numpy as np
import pytest
from cell_helpers import VGA

from plane_detector import segment_planes


@pytest.mark.parametrize('reach_px', [3, 4, 5, 7])
def test_a_box_smeared_over_its_edges_has_its_front_and_the_wall(reach_px):
    """The mean of 1/z over a square of pixels is linear across an edge."""
    for seed in range(9000, 9003):
        disparity = np.full((480, 640), 1 / 3.0)
        disparity[140:330, 220:420] = 1 / 1.2
        ramps = cv2.blur(disparity, (2 * reach_px + 1,) * 2)
        is_ramp = abs(ramps - disparity) > 0.03
        noise = cv2.GaussianBlur(np.random.default_rng(seed).standard_normal(ramps.shape),
                                 (0, 0), 2)
        found = segment_planes(1 / (ramps + 0.0012 * noise / noise.std()), VGA)
        assert len(found.planes) == 2
        assert (found.labels[is_ramp] >= 0).mean() < 0.3


@pytest.mark.parametrize('angle_deg', [3.0, 6.0, 12.0])
def test_the_side_of_a_box_seen_nearly_from_the_side_is_a_plane(angle_deg):
    """The box stands out of a wall 6 m away; its side begins 1 m away, its end is not the wall."""
    ray_x = np.broadcast_to((np.arange(640) - VGA.cx) / VGA.fx, (480, 640))
    slope = np.tan(np.radians(angle_deg))
    side_m = -0.05 / (ray_x - slope + 1e-9)  # x = -.05 + slope * z, from the front to 3 m
    is_side = (side_m > 1.0) & (side_m < 3.0)
    front = ray_x * 1.0 < -0.05 + slope
    depth_m = np.where(is_side, side_m, np.where(front, 1.0, 6.0))
    wide = is_side[0].sum()
    found = segment_planes(depth_m, VGA)
    seen = found.labels[is_side]
    best = np.bincount(seen + 1, minlength=2)[1:].argmax()
    assert wide > 10
    assert (seen == best).mean() > 0.7
    assert abs(found.planes[best].normal[0]) == pytest.approx(np.cos(np.radians(angle_deg)),
                                                               abs=0.02)
