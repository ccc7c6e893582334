# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A disparity of known scale and shift to depth, 1/z = scale * disparity + shift."""

from __future__ import annotations

import numpy as np

from plane_detector.geometry.disparity import to_depth
from plane_detector.types import ScaleEstimate

# Depths beyond this multiple of the arbitrary unit are invalid if metres are unknown.
MAX_RELATIVE_DEPTH = 1000.0


def apply_scale(disparity: np.ndarray, estimate: ScaleEstimate,
                max_depth_m: float = np.inf) -> np.ndarray:
    """
    Return the depth (H, W) float32 of a disparity (H, W), NaN where invalid.

    So is what is farther than ``max_depth_m``, if the unit is the metre.
    """
    farthest = max_depth_m if estimate.is_metric else MAX_RELATIVE_DEPTH
    inverse = np.float32(estimate.scale) * disparity + np.float32(estimate.shift)
    return to_depth(inverse, farthest)
