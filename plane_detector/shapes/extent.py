# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""How far a shape reaches in the image, and whether it ends there or is a part of something."""

from __future__ import annotations

import cv2
import numpy as np

from plane_detector.geometry.robust import dilated
from plane_detector.shapes.models import AXIS, depth_on_rays_m, surface_of
from plane_detector.shapes.refinement import FittedShape, shape_residuals
from plane_detector.shapes.surfels import DEVIATIONS, depth_sigma_m
from plane_detector.shapes.views import DepthView, FoundShape, Window

# derived: cells that the silhouette cuts are no members; a border is up to two of them wide.
_BORDER_CELLS = 2
# The pixels of a silhouette are mixtures; what is looked at lies so many pixels outside.
_RING_PX = 3
# Rays are looked at in steps of this many pixels, to save time.
_THROUGH_STEP_PX = 3
# derived: over as many pixels a surface at 45 degrees to the ray goes as far in depth.
_MAX_GAP_PX = _RING_PX + 1.0


def pixels_on_shape(view: DepthView, found: FoundShape) -> tuple[Window, np.ndarray]:
    """Return the free pixels (h, w) of a window that lie on a shape, connected with its cells."""
    window, mask = view.pixels_of_cells(_dilated_cells(view, found.members))
    mask &= view.is_free(window, found.absorbed)
    mask[mask] = np.abs(shape_residuals(found.fit, view.pixels(window, mask))) < DEVIATIONS
    inner_window, inner = view.pixels_of_cells(found.members)
    core = np.zeros(mask.shape, bool)
    core[tuple(slice(i.start - o.start, i.stop - o.start)
               for i, o in zip(inner_window, window, strict=True))] = inner
    pieces = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)[1]
    on_shape = np.zeros(pieces.max() + 1, bool)
    on_shape[pieces[core & mask]] = True
    return window, mask & on_shape[pieces]


def seen_through_cost(view: DepthView, fit: FittedShape, members: np.ndarray) -> float:
    """
    Return what rays cost that go through the surface of a shape: each counts as an outlier.

    A cylinder may fit the depth of a cone, but not its silhouette.
    """
    window, mask = view.pixels_of_cells(_dilated_cells(view, members))
    thinned = np.zeros(mask.shape, bool)
    thinned[::_THROUGH_STEP_PX, ::_THROUGH_STEP_PX] = True
    thinned &= mask & np.isfinite(view.depth_m[window])
    pixels = view.pixels(window, thinned)
    along_m = surface_of(fit.shape, view.surfels.points_m[members]).along_m
    ends_m = (along_m.min(), along_m.max()) if fit.shape[AXIS].any() else (-np.inf, np.inf)
    depth_m = depth_on_rays_m(fit.shape, pixels.rays, ends_m)
    through = pixels.points_m[:, 2] - depth_m > DEVIATIONS * pixels.depth_sigma_m
    share = pixels.independent / max(len(through), 1)
    return float(DEVIATIONS**2 * through.sum() * _THROUGH_STEP_PX**2 * share)


def open_share(view: DepthView, found: FoundShape) -> float:
    """
    Return the share, 0 to 1, of a shape's border in the image where the surface goes on.

    It does where pixels just outside belong to no plane and lie at the depth of those inside.
    """
    window, mask = pixels_on_shape(view, found)
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
    goes_on = view.is_free(window, view.is_open)[ring] & (gap_m < allowed_m)
    return float(goes_on.mean()) if goes_on.size else 0.0


def _dilated_cells(view: DepthView, members: np.ndarray) -> np.ndarray:
    return dilated(members.reshape(view.shape), _BORDER_CELLS).ravel()
