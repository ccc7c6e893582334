# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""How the large planes that a sensor measured were found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.evaluation.metrics import overlap

LARGE_PLANE_SHARE = 0.02
# A predicted plane that holds this share of a sensor's plane is one of its pieces.
PIECE_SHARE = 0.1


@dataclass(frozen=True)
class Coverage:
    """
    How the sensor's large planes were found.

    Attributes
    ----------
    planes : int
        How many the sensor has over LARGE_PLANE_SHARE of the picture.
    share : float
        Of their pixels, those that a predicted plane with IoU > 0.5 covers; NaN without any.
    pieces : float
        Mean number of predicted planes that each of them is cut into.

    """

    planes: int
    share: float
    pieces: float


def judge_coverage(sensor_labels: np.ndarray, labels: np.ndarray,
                   seen: np.ndarray) -> Coverage:
    """
    Say how the large planes of the sensor's depth were found.

    Parameters
    ----------
    sensor_labels, labels : (H, W) int
        Planes of the sensor's depth and predicted planes, -1 none.
    seen : (H, W) bool
        Where the sensor measured; only these pixels count.

    """
    shared = overlap(sensor_labels, labels, seen)
    pixels = shared.counts[:-1].sum(1)
    large = pixels > LARGE_PLANE_SHARE * seen.size
    if not large.any():
        return Coverage(0, float('nan'), float('nan'))
    both = shared.counts[:-1, :-1]
    covered = (both * (shared.iou > 0.5)).sum(1)[large].sum()
    pieces = (both > PIECE_SHARE * pixels[:, None]).sum(1)[large]
    return Coverage(int(large.sum()), float(covered / pixels[large].sum()), float(pieces.mean()))
