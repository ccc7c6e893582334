# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A plane that was seen long keeps its label, and a plane that was gone does not take it."""

import numpy as np

from plane_detector.config import TrackingConfig
from plane_detector.tracking.tracker import PlaneTracker
from plane_detector.types import Plane, Planes, PlaneSegmentation

CONFIG = TrackingConfig()


def image(*columns):
    """Return a wall 3 m ahead that is found in parts, each with its first and last column."""
    labels = np.full((120, 160), -1, np.int32)
    planes = []
    for index, (first, last) in enumerate(columns):
        labels[:, first:last] = index
        middle_m = (first + last - 160) / 2 * 0.02
        planes.append(Plane(np.array([0, 0, -1.0]), 3.0, np.array([middle_m, 0, 3.0]),
                            120 * (last - first), 0.001, 0.048 * (last - first),
                            np.diag([1e-6] * 4), 1.0))
    return PlaneSegmentation(Planes.of(planes), labels, 0.001)


def labels_of(tracker, *columns):
    return tracker.update(image(*columns), CONFIG).planes.labels.tolist()


def test_a_fragment_of_one_image_does_not_take_the_label_of_a_wall():
    """The wall falls into two parts once; then somebody hides most of the larger one."""
    tracker = PlaneTracker()
    for _ in range(10):
        assert labels_of(tracker, (0, 160)) == [1]
    assert labels_of(tracker, (60, 160), (0, 60)) == [1, 2]
    assert labels_of(tracker, (0, 90)) == [1]


def test_a_plane_that_was_missed_yields_to_one_that_was_seen():
    """A wall hidden for an image, and what was found in its place, join into one plane."""
    tracker = PlaneTracker()
    for _ in range(5):
        assert labels_of(tracker, (0, 80), (90, 150)) == [1, 2]
    assert labels_of(tracker, (90, 150)) == [2]
    assert labels_of(tracker, (0, 160)) == [2]
