# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Every method with the common interface works, or names the missing package."""

import numpy as np
import pytest

from plane_detector.evaluation import peers
from plane_detector.evaluation.datasets import numbered
from plane_detector.evaluation.metrics import score
from plane_detector.evaluation.scenes.rooms import single_wall
from plane_detector.types import CameraIntrinsics

SMALL = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)


@pytest.mark.parametrize('method', peers.all_methods(), ids=lambda method: method.name)
def test_every_method_finds_a_wall_or_says_why_it_cannot(method):
    if method.absent:
        pytest.skip(method.absent)
    wall = single_wall(SMALL, yaw_deg=20, distance_m=2.0)
    labels, planes = method(wall.depth_m, SMALL)
    result = score(wall.labels, wall.planes, labels, planes, np.isfinite(wall.depth_m))
    assert labels.shape == (120, 160)
    assert labels.max() == len(planes) - 1
    assert result.recall == 1
    assert result.normal_error_deg < 1
    assert result.offset_error_m < 0.02
    assert (planes[:, 3] >= 0).all()


def test_labels_are_renumbered_without_gaps():
    values = np.array([[0, 7], [3, 7]])
    np.testing.assert_array_equal(numbered(values, values > 0), [[-1, 1], [0, 1]])
