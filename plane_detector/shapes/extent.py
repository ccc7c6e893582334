# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Extent of a shape in the image, and whether its surface ends at its border."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from plane_detector.geometry.robust import dilated
from plane_detector.shapes.models import AXIS, surface_of
from plane_detector.shapes.refinement import FittedShape
from plane_detector.shapes.surface import DEVIATIONS
from plane_detector.shapes.surfels import depth_sigma_m
from plane_detector.shapes.views import DepthView, FoundShape
from plane_detector.shapes.windows import THROUGH_STEP_PX, pixels_on, rays_through

# derived: cells cut by the silhouette are not members; they form a border of at most two cells.
_BORDER_CELLS = 2
# Pixels at a silhouette are mixtures, so the surroundings are examined this far outside.
_RING_PX = 3
# derived: over this many pixels a surface at 45 degrees to the ray changes as much in depth.
_MAX_GAP_PX = _RING_PX + 1.0


def on_image(view: DepthView, found: FoundShape) -> FoundShape:
    """Return a shape with the free pixels that lie on it and are connected with its cells."""
    cells = dilated_cells(view, found.members)
    window = view.window_of(cells)
    ends = tuple(end for side in window for end in (side.start, side.stop))
    mask = pixels_on(view.image_with(found.absorbed), cells, ends, found.fit.shape, view.camera)
    count, pieces = cv2.connectedComponents(mask, connectivity=8)
    rows, columns = (np.arange(side.start, side.stop) // view.size_px for side in window)
    core = found.members.reshape(view.shape)[np.ix_(rows, columns)]
    on_shape = np.zeros(count, bool)
    on_shape[pieces[core]] = True
    on_shape[0] = False
    return replace(found, window=window, mask=on_shape[pieces])


def seen_through_cost(view: DepthView, fit: FittedShape, members: np.ndarray,
                      around: np.ndarray) -> float:
    """
    Return the cost of rays that pass through the surface of a shape; each counts as an outlier.

    A cylinder may fit the depth of a cone, but not its silhouette. The rays are those of the cells
    (R, C) around the members (R * C,) of the shape.
    """
    along_m = surface_of(fit.shape, view.surfels.points_m[members]).along_m
    ends_m = (along_m.min(), along_m.max()) if fit.shape[AXIS].any() else (-np.inf, np.inf)
    through = rays_through(view.depth_m, around, fit.shape, ends_m, view.camera)
    return DEVIATIONS**2 * through * THROUGH_STEP_PX**2 / view.correlated


def open_share(view: DepthView, found: FoundShape) -> float:
    """
    Return the share, 0 to 1, of the border of a shape across which the surface continues.

    It continues where pixels just outside have no plane and the same depth as those inside.
    """
    window, mask = found.window, found.mask
    near, far = (cv2.dilate(mask.astype(np.uint8), np.ones((2 * k + 1, 2 * k + 1), np.uint8))
                 for k in (_RING_PX - 1, _RING_PX))
    ring = (far > near) & np.isfinite(view.depth_m[window])
    side = 2 * _RING_PX + 1
    inside = mask.astype(np.float32)
    depth_m = np.where(mask, view.depth_m[window], 0).astype(np.float32)
    total_m, count = (cv2.boxFilter(one, -1, (side, side), normalize=False,
                                    borderType=cv2.BORDER_CONSTANT) for one in (depth_m, inside))
    ring &= count > 0.5
    level_m = total_m[ring] / count[ring]
    gap_m = np.abs(view.depth_m[window][ring] - level_m)
    allowed_m = (_MAX_GAP_PX * level_m / view.intrinsics.fx + DEVIATIONS * depth_sigma_m(
        level_m, view.noise.mean_sigma, view.noise.depth_floor_m))
    goes_on = view.is_free(window)[ring] & (gap_m < allowed_m)
    return float(goes_on.mean()) if goes_on.size else 0.0


def dilated_cells(view: DepthView, members: np.ndarray) -> np.ndarray:
    """Return the cells (R, C) bool that the silhouette of some cells (R * C,) may cross."""
    return np.ascontiguousarray(dilated(members.reshape(view.shape), _BORDER_CELLS), bool)
