# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""When two labels become one, the remaining plane names the merged label."""

from dataclasses import replace

import numpy as np
import pytest

from plane_detector.tracking.tracker import merged_labels
from plane_detector.types import Detection, Plane, Planes


def wall(distance_m=2.0, x_m=0.0):
    return Plane(np.array([0.0, 0.0, -1.0]), distance_m, np.array([x_m, 0.0, distance_m]), 2000,
                 0.0, 1.0, np.diag([1e-8] * 4), 1.0)


def detection(labels, planes, track_labels):
    planes = replace(Planes.of(planes), labels=np.array(track_labels))
    return Detection(planes, labels, 0.0, np.full(labels.shape, 2.0, np.float32), 'metric')


@pytest.fixture
def halves():
    """Return a wall that a cupboard cuts in two."""
    labels = np.full((60, 100), -1, np.int32)
    labels[:, :40], labels[:, 45:] = 0, 1
    return detection(labels, (wall(x_m=-0.5), wall(x_m=0.5)), (7, 3))


@pytest.fixture
def whole():
    return detection(np.zeros((60, 100), np.int32), (wall(),), (3,))


def test_the_merged_label_is_named(halves, whole):
    assert merged_labels(halves, whole) == (7,)


def test_an_occluding_plane_does_not_merge_the_one_behind(halves):
    """A box moves in front of the left half: it hides it and is another plane."""
    labels = halves.labels.copy()
    labels[:, :45] = 0
    hidden = detection(labels, (wall(1.0), wall()), (5, 3))
    assert merged_labels(halves, hidden) == (0, 0)
    known_before = detection(labels, (wall(1.0), wall()), (3, 9))
    assert merged_labels(halves, known_before) == (0, 0), 'not in its plane'
