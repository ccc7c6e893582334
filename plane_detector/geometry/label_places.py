# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Where the regions of a label image have their borders, and where they are widest."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np


class LabelPlace(NamedTuple):
    """A pixel, and its distance from the border of its region."""

    row: int
    column: int
    half_width_px: float


def label_places(labels: np.ndarray) -> dict[int, LabelPlace]:
    """
    Return where the region of each label is widest, which is where to write on it.

    Parameters
    ----------
    labels : (H, W) integer
        0 for no region. One pixel of sixteen is looked at, so that small regions may be missing.

    Examples
    --------
    >>> place = label_places(np.pad(np.ones((5, 5), int), 1))[1]
    >>> place.row, place.column
    (2, 2)

    """
    step = 4 if min(labels.shape) >= 64 else 1  # a sixteenth of the pixels show where that is
    small = np.ascontiguousarray(labels[::step, ::step])
    inside = np.pad((~label_edges(small)).astype(np.uint8), 1)
    half_width = cv2.distanceTransform(inside, cv2.DIST_L2, 3)[1:-1, 1:-1]
    places = {}
    for label in np.unique(small[small > 0]).tolist():
        widest = np.argmax(np.where(small == label, half_width, -1))
        row, column = np.unravel_index(widest, small.shape)
        places[label] = LabelPlace(step * int(row), step * int(column),
                                   step * float(half_width[row, column]))
    return places


def label_edges(labels: np.ndarray) -> np.ndarray:
    """Return where a pixel's right or lower neighbour has another label, (H, W) bool."""
    edge = np.zeros(labels.shape, bool)
    edge[:, :-1] = labels[:, :-1] != labels[:, 1:]
    edge[:-1] |= labels[:-1] != labels[1:]
    return edge
