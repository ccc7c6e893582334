# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Detection of merged labels: two labels that have become one plane."""

from __future__ import annotations

import numpy as np

from plane_detector.tracking.matching import PlaneArrays, squared_deviation
from plane_detector.types import Detection

# derived: more than half of the pixels, so that a plane can be merged into only one other.
_MIN_SHARE = 0.5
# derived: three standard deviations, as for other decisions on coefficients.
_MOST_DEVIATIONS = 3.0


def merged_labels(before: Detection | None, after: Detection) -> tuple[int, ...]:
    """
    Return, for each plane of an image, the label that was merged into it since the last image.

    A label that has disappeared was merged into a plane that existed before, now covers most of
    its pixels, and is coplanar with it. 0: none; the largest plane if there are several.
    """
    taken = np.zeros(len(after.planes), int)
    if (before is None or not before.track_labels or not after.track_labels
            or before.labels.shape != after.labels.shape):
        return tuple(taken.tolist())
    most = np.zeros(len(after.planes), int)
    for old, label in enumerate(before.track_labels):
        if label in after.track_labels:
            continue
        pixels = after.labels[before.labels == old]
        # Entry 0 counts the pixels without a plane; entries after the planes are of shapes.
        counts = np.bincount(pixels + 1, minlength=len(after.planes) + 1)[1:len(after.planes) + 1]
        new = int(np.argmax(counts))
        if (counts[new] > max(_MIN_SHARE * pixels.size, most[new])
                and _is_taken(before, old, after, new)):
            taken[new], most[new] = label, counts[new]
    return tuple(taken.tolist())


def _is_taken(before: Detection, old: int, after: Detection, new: int) -> bool:
    """Return whether the other label existed before, and both are one plane."""
    if after.track_labels[new] not in before.track_labels:
        return False
    deviation = squared_deviation(PlaneArrays.of([before.planes[old]]),
                                  PlaneArrays.of([after.planes[new]]))
    return bool(deviation.item() <= _MOST_DEVIATIONS**2)
