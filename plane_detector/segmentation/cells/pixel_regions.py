# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Result of the segmentation: the pixels of each plane, and the data for measuring the planes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from plane_detector.segmentation.cells.grid import CellGrid
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.plane_fit import DD, XD, YD, D, N, X, Y

# chosen: a sixteenth of the pixels; a patch that is narrower on the image holds few of them.
PATCH_SCALE = 4
NO_PATCHES = NO_FACETS = np.zeros((0, 0), np.int32)


@dataclass(frozen=True)
class PixelRegions:
    """Regions of pixels, each on one plane, in the unit of the disparity."""

    disparity: np.ndarray  # (H, W) float32: 0 where invalid
    # (H, W) int32: index into ``coefficients``, -1 for no plane and where disparity is invalid
    labels: np.ndarray
    # (K, 3) float64: a, b, c of d = a x + b y + c in the coordinates of the cells; some may have
    # no pixels
    coefficients: np.ndarray
    grid: CellGrid  # of this disparity
    noise: Noise  # of this disparity
    # area over which the smooth part of the noise is the same, in pixels; 0: not known
    correlated_px: float = 0.0
    # float or (K,) float64: probability that the regions are oriented as their planes, where not
    # the depth alone decides
    certainty: float | np.ndarray = 1.0
    # float or (K,) float64: probability that they are horizontal, vertical or neither as their
    # planes, where not the depth alone decides; NaN: it does
    class_certainty: float | np.ndarray = np.nan
    # float or (K,) float64: angle by which normals of a network have rotated each from its depth
    rotated_rad: float | np.ndarray = 0.0
    # (h, w) int32: for every PATCH_SCALE-th row and column, the patch of one colour of the image,
    # each one surface of the scene; 0 none. Of no size if only the depth decides
    patches: np.ndarray = field(default_factory=NO_PATCHES.copy)
    # (H, W) int32: as ``labels``, for the pixels of curved surfaces, which are no planes, but are
    # made of pieces that are flat within the noise. Of no size if there are none
    facets: np.ndarray = field(default_factory=NO_FACETS.copy)

    def rescaled(self, scale: float, shift: float) -> PixelRegions:
        """Return the same regions in the unit of 1/z = scale * disparity + shift, scale > 0."""
        if scale == 1 and shift == 0:
            return self
        return replace(self, disparity=np.float32(scale) * self.disparity + np.float32(shift),
                       coefficients=scale * self.coefficients + [0.0, 0.0, shift],
                       grid=_rescaled_grid(self.grid, scale, shift),
                       noise=self.noise.rescaled(scale))

    def mesh_shares(self) -> np.ndarray:
        """Return the share (K,) of the pixels of each region that lie in cells of a mesh."""
        count, (height, width) = len(self.coefficients), self.labels.shape
        if not self.grid.is_mesh.any():
            return np.zeros(count)
        cells = self.grid.is_mesh.reshape(self.grid.shape)
        is_mesh = cells.repeat(self.grid.size_px, 0).repeat(self.grid.size_px, 1)[:height, :width]
        mesh, all_pixels = (np.bincount(labels[labels >= 0], minlength=count)
                            for labels in (self.labels[is_mesh], self.labels))
        return mesh / np.maximum(all_pixels, 1)

    def of_facets(self) -> PixelRegions:
        """Return the regions of the pieces of curved surfaces instead of those of planes."""
        return replace(self, labels=self.facets, facets=NO_FACETS)

    def restricted_to(self, valid: np.ndarray) -> PixelRegions:
        """Return the regions without the pixels where ``valid`` (H, W) bool is False."""
        facets = np.where(valid, self.facets, -1) if self.facets.size else self.facets
        return replace(self, labels=np.where(valid, self.labels, -1), facets=facets)


def _rescaled_grid(grid: CellGrid, scale: float, shift: float) -> CellGrid:
    """Substitute scale * d + shift for d in the sums over the pixels of each cell."""
    moments, mean = grid.moments.copy(), grid.mean.copy()
    n, x, y, d, xd, yd, dd = grid.moments[:, [N, X, Y, D, XD, YD, DD]].T
    moments[:, D] = scale * d + shift * n
    moments[:, XD], moments[:, YD] = scale * xd + shift * x, scale * yd + shift * y
    moments[:, DD] = scale * (scale * dd + 2 * shift * d) + shift**2 * n
    mean[:, 2] = moments[:, D] / np.maximum(n, 1)
    return replace(grid, moments=moments, mean=mean, slope=scale * grid.slope,
                   residual_rms=scale * grid.residual_rms, normal_slope=scale * grid.normal_slope)
