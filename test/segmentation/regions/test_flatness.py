# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A surface that departs from a plane by no more than the user tolerates is one plane."""

from dataclasses import replace

import numpy as np
import pytest
from cell_helpers import cell_model, fold, hand_made, view, wall

from plane_detector import CameraIntrinsics, Config, segment_planes
from plane_detector.segmentation.regions.merging import join_nearly_flat
from plane_detector.segmentation.regions.region_graph import RegionGraph

NONE = np.zeros(0, int)
CAMERA = CameraIntrinsics.from_field_of_view(320, 240, 60.0)
DIPPED = view(fold(3), intrinsics=CAMERA)
STEP = view([wall(2.0, right_m=0), wall(2.01, 0)], intrinsics=CAMERA)


def flat_to(distance_m, angle_deg=4.0):
    """Return the default settings of the segmentation, but for what is flat."""
    return replace(Config().segmentation, flatness_distance=distance_m, flatness_angle=angle_deg)


def joined(scene, settings, removed=NONE):
    """Return the owners of the left and the right half, and the planes."""
    model = cell_model(scene.depth_m)
    labels = np.zeros(model.grid.shape, int)
    labels[:, model.grid.shape[1] // 2:] = 1
    regions = hand_made(model, labels)
    return join_nearly_flat(model, RegionGraph.of(model, regions), removed, None,
                            settings), regions


@pytest.mark.parametrize(('scene', 'settings', 'count'), [
    (DIPPED, flat_to(0.05), 1), (DIPPED, flat_to(0.05, 2.0), 2), (DIPPED, flat_to(0.002), 2),
    (DIPPED, flat_to(0.0), 2), (STEP, flat_to(0.05), 2)],
    ids=['flat enough', 'too steep', 'too far off', 'never', 'step'])
def test_both_tolerances_decide_and_steps_stay(scene, settings, count):
    (owner, planes), regions = joined(scene, settings)
    assert len(np.unique(owner)) == count
    if count == 1:
        whole = hand_made(cell_model(scene.depth_m), np.zeros(regions.labels.shape, int))
        np.testing.assert_allclose(planes[0], whole.coefficients[0], rtol=1e-9, atol=1e-12)
    else:
        np.testing.assert_array_equal(planes, regions.coefficients)


def test_removed_regions_are_joined_to_none():
    (owner, _), _ = joined(DIPPED, flat_to(0.05), removed=np.array([1]))
    np.testing.assert_array_equal(owner, [0, 1])


@pytest.mark.parametrize(('distance_m', 'count'), [(0.05, 1), (0.0, 2)])
def test_the_whole_segmentation_asks_the_settings(distance_m, count):
    config = replace(Config(), segmentation=flat_to(distance_m))
    found = segment_planes(DIPPED.depth_m, CAMERA, config)
    assert len(found.planes) == count
    assert (found.labels >= 0).mean() > 0.99
