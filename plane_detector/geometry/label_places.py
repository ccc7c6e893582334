# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Borders of the regions of a label image, and the pixels at which they are widest."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from plane_detector.compilation import kernel


class LabelPlace(NamedTuple):
    """A pixel, and its distance from the border of its region."""

    row: int
    column: int
    half_width_px: float


def label_places(labels: np.ndarray) -> dict[int, LabelPlace]:
    """
    Return the pixel at which the region of each label is widest, to write its number there.

    Parameters
    ----------
    labels : (H, W) integer
        0 for no region. Only every fourth row and column is used: small regions may be missing.

    Examples
    --------
    >>> place = label_places(np.pad(np.ones((5, 5), int), 1))[1]
    >>> place.row, place.column
    (2, 2)

    """
    step = 4 if min(labels.shape) >= 64 else 1  # for speed
    small = labels[::step, ::step].astype(np.int32)
    inside = np.pad((~label_edges(small)).astype(np.uint8), 1)
    half_width = cv2.distanceTransform(inside, cv2.DIST_L2, 3)
    pixels, half_widths = _widest(small, half_width, int(small.max(initial=0)) + 1)
    found = np.flatnonzero(pixels >= 0)
    rows, columns = np.divmod(pixels[found], small.shape[1])
    places = np.stack([rows, columns, half_widths[found]]) * step
    return {label: LabelPlace(int(row), int(column), half_width_px) for label, row, column,
            half_width_px in zip(found.tolist(), *places.tolist(), strict=True)}


@kernel('Tuple((int64[::1], float32[::1]))(int32[:, ::1], float32[:, ::1], int64)', is_short=True)
def _widest(labels, half_width, count):
    """Return the pixel, row by row, of each label's largest value, -1 without one, and that."""
    pixels, largest = np.full(count, -1, np.int64), np.full(count, -1, np.float32)
    for v in range(labels.shape[0]):
        for u in range(labels.shape[1]):
            k = labels[v, u]
            if k > 0 and half_width[v + 1, u + 1] > largest[k]:
                pixels[k], largest[k] = v * labels.shape[1] + u, half_width[v + 1, u + 1]
    return pixels, largest


def label_edges(labels: np.ndarray) -> np.ndarray:
    """Return the pixels whose right or lower neighbour has another label, (H, W) bool."""
    edge = np.zeros(labels.shape, bool)
    edge[:, :-1] = labels[:, :-1] != labels[:, 1:]
    edge[:-1] |= labels[:-1] != labels[1:]
    return edge
