# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Scale and shift of a disparity, 1/z = scale * disparity + shift, and their application."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from plane_detector.geometry.disparity import to_depth

RELATIVE = 'relative'
# Depths beyond this multiple of the arbitrary unit are invalid if metres are unknown.
MAX_RELATIVE_DEPTH = 1000.0


@dataclass(frozen=True)
class ScaleEstimate:
    """1/z = scale * disparity + shift, and the method that estimated it."""

    # 1/metres, or 1/unit if the unit is unknown; the unit is then the median depth of the image
    # for which it was chosen.
    scale: float
    shift: float
    method: str  # metric, depth_topic, camera_height, manhattan, fixed or relative
    is_metric: bool  # not for relative, nor for manhattan without a height
    has_true_angles: bool  # between planes; for relative only if the network's depth has no shift
    # Standard deviation of depth due to scale and shift, as a share of depth, at the disparity
    # quantile of the farthest 10 % of the image; NaN if unknown.
    uncertainty: float
    note: str  # result of the method, or why the others refused; for the log and the diagnostics
    span: tuple[float, float, float]  # 10 %, 50 %, 90 % of disparity; NaN for metric
    # Standard deviation of normals due to the shift; NaN if unknown.
    angle_sigma_deg: float = np.nan

    @property
    def unit_method(self) -> str:
        """Method that determined the unit; ``relative`` if none did."""
        return self.method if self.is_metric else RELATIVE

    def with_covariance(self, covariance: np.ndarray) -> ScaleEstimate:
        """Return the estimate with its uncertainty from the covariance of scale and shift."""
        far = np.array([self.span[0], 1.0])
        inverse_depth = far @ [self.scale, self.shift]
        sigma = np.sqrt(max(far @ covariance @ far, 0.0))
        return replace(self, uncertainty=float(sigma / inverse_depth)
                       if inverse_depth > 0 else np.nan)

    def __str__(self) -> str:
        sigma = f', +-{self.uncertainty:.1%}' if np.isfinite(self.uncertainty) else ''
        unit = '' if self.is_metric else ', unit unknown'
        angles = (f', angles +-{self.angle_sigma_deg:.1f} deg'
                  if np.isfinite(self.angle_sigma_deg) else '')
        return f'{self.method}{unit}{sigma}{angles}: {self.note}'


def apply_scale(disparity: np.ndarray, estimate: ScaleEstimate,
                max_depth_m: float = np.inf) -> np.ndarray:
    """
    Return the depth (H, W) float32 of a disparity (H, W), NaN where invalid.

    So is what is farther than ``max_depth_m``, if the unit is the metre.
    """
    farthest = max_depth_m if estimate.is_metric else MAX_RELATIVE_DEPTH
    inverse = np.float32(estimate.scale) * disparity + np.float32(estimate.shift)
    return to_depth(inverse, farthest)
