# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Planes of an image as affine functions of a disparity of unknown scale and shift.

With the ray (x, y, 1) of a pixel, a plane is D = p x + q y + r in any disparity that is affine
in 1/z. If 1/z = scale * (D + tau), its normal is proportional to (p, q, r + tau): the angles
between planes depend only on tau, the shift in units of D.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MAX_PLANES, MIN_PIXEL_SHARE = 16, 0.004
"""Of the planes that vote; smaller ones are mostly clutter."""


@dataclass(frozen=True)
class DisparityPlanes:
    """Planes found in an image."""

    coefficients: np.ndarray  # (N, 3) float64: p, q, r; x, y are the slopes of the pixel's ray
    information: np.ndarray  # (N, 3, 3) float64: inverse covariance of the coefficients
    centers: np.ndarray  # (N, 2) float64: mean x, y of the pixels of each plane
    pixel_share: np.ndarray  # (N,) float64, of each plane in the pixels of all these planes
    labels: np.ndarray  # (N,) int64: index of each plane among those of the segmentation

    def __len__(self) -> int:
        return len(self.labels)

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of the coefficients, (N, 3, 3)."""
        return np.linalg.inv(self.information)

    def scaled(self, scale: float, shift: float) -> np.ndarray:
        """
        Return the coefficients (N, 3) of the planes in 1/z = scale * D + shift.

        The plane n . p + d = 0 has the coefficients -n / d.
        """
        return scale * self.coefficients + [0.0, 0.0, shift]

    def normals(self, tau: np.ndarray) -> np.ndarray:
        """Return the normals (T, N, 3) for shifts (T,), each as long as (p, q, r + tau)."""
        normals = np.repeat(self.coefficients[None], len(tau), axis=0)
        normals[..., 2] += tau[:, None]
        return normals

    def largest(self) -> DisparityPlanes:
        """Return the planes that are large enough to vote, the largest first."""
        order = np.argsort(-self.pixel_share)[:MAX_PLANES]
        return self.take(order[self.pixel_share[order] >= MIN_PIXEL_SHARE])

    def take(self, index: np.ndarray) -> DisparityPlanes:
        """Return the selected planes, in the order of the index."""
        return DisparityPlanes(self.coefficients[index], self.information[index],
                               self.centers[index], self.pixel_share[index], self.labels[index])
