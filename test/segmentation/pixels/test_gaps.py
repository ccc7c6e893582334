# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Narrow gaps within planes."""

import numpy as np
import pytest

from plane_detector.pipeline import segment_planes
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(400.0, 500.0, 180.0, 110.0, 320, 240)


def wall_with_joints(depth_of_joints_m, width_px):
    """Return the depth of a slanted wall, 2 m ahead, with a grid of joints behind it."""
    ray = (np.arange(CAMERA.width) - CAMERA.cx) / CAMERA.fx
    depth_m = np.tile(2.0 / (1 + 0.3 * ray), (CAMERA.height, 1))
    is_joint = np.zeros(depth_m.shape, bool)
    for start in range(20, 320, 60):
        is_joint[:, start:start + width_px] = True
        is_joint[start:start + width_px] = True
    return np.where(is_joint, depth_m + depth_of_joints_m, depth_m).astype(np.float32), is_joint


@pytest.mark.parametrize('depth_of_joints_m, belongs', [(0.008, True), (0.08, False)])
def test_joints_belong_to_their_wall_if_they_are_shallow(depth_of_joints_m, belongs):
    depth_m, is_joint = wall_with_joints(depth_of_joints_m, 3)
    labels = segment_planes(depth_m, CAMERA).labels
    assert (labels[~is_joint] == 0).mean() > 0.98
    share = (labels[is_joint] == 0).mean()
    assert share > 0.9 if belongs else share < 0.3


def test_holes_in_the_depth_stay_holes():
    depth_m, is_joint = wall_with_joints(0.0, 3)
    depth_m[is_joint] = np.nan
    assert (segment_planes(depth_m, CAMERA).labels[is_joint] == -1).all()
