# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""When two labels become one, the remaining plane names the merged label."""

from dataclasses import replace

import numpy as np
import pytest

from plane_detector.config import TrackingConfig
from plane_detector.tracking.tracker import PlaneTracker
from plane_detector.types import Plane, Planes, PlaneSegmentation


def wall(distance_m=2.0, x_m=0.0):
    return Plane(np.array([0.0, 0.0, -1.0]), distance_m, np.array([x_m, 0.0, distance_m]), 2000,
                 0.0, 1.0, np.diag([1e-8] * 4), 1.0)


def segmented(labels, *planes):
    return PlaneSegmentation(Planes.of(planes), labels, 0.0)


def merged(*images):
    """Return labels and merged labels of the last of some images."""
    tracker = PlaneTracker()
    for image in images:
        planes = tracker.update(image, TrackingConfig()).planes
    return planes.labels.tolist(), planes.merged.tolist()


@pytest.fixture
def halves():
    """Return a wall that a cupboard cuts in two, and the corner of a box before it."""
    labels = np.full((60, 100), -1, np.int32)
    labels[:, :40], labels[:, 45:], labels[:10, 40:45] = 0, 1, 2
    return segmented(labels, wall(x_m=-0.5), wall(x_m=0.3), wall(1.0))


def test_the_merged_label_is_named(halves):
    whole = segmented(np.zeros((60, 100), np.int32), wall())
    assert merged(halves, whole) == ([2], [1])
    assert merged(halves, whole, whole) == ([2], [0]), 'once'


def test_of_two_the_larger_is_named():
    labels = np.zeros((60, 100), np.int32)
    labels[:, :20], labels[:, 70:] = 1, 2
    pieces = segmented(labels, wall(), wall(x_m=-0.8), wall(x_m=0.6))
    assert merged(pieces, segmented(np.zeros_like(labels), wall())) == ([1], [3])


def test_an_occluding_plane_does_not_merge_the_one_behind(halves):
    """A box moves in front of the left half: it hides it and is another plane."""
    labels = halves.labels.copy()
    labels[:, :45] = 2
    labels[labels < 0] = 2
    hidden = segmented(np.where(labels == 1, 0, 1).astype(np.int32), wall(x_m=0.3), wall(1.0))
    assert merged(halves, hidden) == ([2, 3], [0, 0]), 'known before, but not in its plane'


def test_a_plane_that_is_new_merges_nothing(halves):
    """A door swings open before both: their labels are lost."""
    door = replace(wall(), normal=np.array([0.8, 0.0, -0.6]), offset_m=1.2)
    new = segmented(np.zeros((60, 100), np.int32), door)
    assert merged(halves, new) == ([4], [0])


def test_a_label_that_was_missing_before_is_not_merged_now(halves):
    right = segmented(np.where(halves.labels == 1, 0, -1).astype(np.int32), wall(x_m=0.3))
    whole = segmented(np.zeros((60, 100), np.int32), wall())
    assert merged(halves, right, whole) == ([2], [0])


def test_a_plane_that_comes_back_merges_nothing(halves):
    """The left half is new in the image in which the well-known right one is missed."""
    labels = halves.labels
    right = segmented(np.where(labels == 1, 0, -1).astype(np.int32), wall(x_m=0.3))
    left = segmented(np.where(labels == 0, 0, -1).astype(np.int32), wall(x_m=-0.5))
    whole = segmented(np.zeros((60, 100), np.int32), wall())
    assert merged(*[right] * 9, left, whole) == ([1], [0])
