# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""From cells to pixels: the extent of a shape, whether it ends there, labels, measurement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from plane_detector.geometry.robust import dilated, touching
from plane_detector.shapes.fitting import (
    explained_share,
    fit_shape,
    fit_silhouette,
    shape_residuals,
)
from plane_detector.shapes.surface import (
    AXIS,
    DEVIATIONS,
    HALF_ANGLE,
    POSITION,
    RADIUS,
    surface_of,
)
from plane_detector.shapes.surfels import depth_sigma_m
from plane_detector.shapes.views import DepthView, FoundShape
from plane_detector.types import PlaneSegmentation, Shape, ShapeType

# Remaining planes, shapes, and the index of the shape (H, W) int32 in each pixel, -1 none.
PlanesAndShapes = tuple[PlaneSegmentation, tuple[Shape, ...], np.ndarray]
# chosen: size of the smallest shape, as a share of the pixels, and the most shapes of an image.
MIN_SHARE, _MOST_SHAPES = 0.001, 16
# Pixels at a silhouette are mixtures, so the surroundings are examined this far outside.
_RING_PX = 3
# derived: over this many pixels, the depth of a surface at 45 degrees to the ray changes as much.
_MAX_GAP_PX = _RING_PX + 1.0
# Quantiles, so that a few outliers do not lengthen a shape.
_LENGTH_QUANTILES = (0.01, 0.99)
# Pieces are merged if one shape explains this share of the pixels of both.
# tuned: benchmark shapes --first-seed 100 --scenes 40; flat from 0.63 to 0.93.
_MIN_JOINT_SHARE = 0.9
# derived: saves a fit of a third of a millisecond; no fit explains pieces that are farther apart.
_FAR_DEVIATIONS = 10 * DEVIATIONS


def on_image(view: DepthView, found: FoundShape) -> FoundShape:
    """Return a shape with the free pixels that lie on it and are connected with its cells."""
    cells = view.around(found.members)
    window = view.window_of(cells)
    mask = view.mask_on(found.fit.shape, cells, window, found.absorbed)
    rows, columns = (np.arange(side.start, side.stop) // view.size_px for side in window)
    core = found.members.reshape(view.shape)[np.ix_(rows, columns)]
    return replace(found, window=window, mask=touching(mask, core, connectivity=8))


def open_share(view: DepthView, found: FoundShape) -> float:
    """
    Return the share, 0 to 1, of the border of a shape across which the surface continues.

    It continues where pixels just outside have no plane and the same depth as those inside.
    """
    window, mask = found.window, found.mask
    ring = (dilated(mask, _RING_PX) & ~dilated(mask, _RING_PX - 1)
            & np.isfinite(view.depth_m[window]))
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
    goes_on = view.is_free[window][ring] & (gap_m < allowed_m)
    return float(goes_on.mean()) if goes_on.size else 0.0


def label_shapes(view: DepthView, planes: PlaneSegmentation,
                 found: Sequence[FoundShape]) -> PlanesAndShapes:
    """Return the remaining planes, the shapes, and their index (H, W) int32 in each pixel."""
    gone, kept = np.zeros(len(planes.planes), bool), []
    taken = np.zeros(planes.labels.shape, bool)
    joined = sorted(_joined(view, list(found)), key=lambda one: -one.members.sum())
    for one in joined[:_MOST_SHAPES]:
        mask = one.mask & ~taken[one.window]
        if mask.sum() >= MIN_SHARE * taken.size:
            taken[one.window] |= mask
            gone |= one.absorbed
            kept.append(replace(one, mask=mask))
    shape_labels = np.full(taken.shape, -1, np.int32)
    for k, one in enumerate(kept):
        shape_labels[one.window][one.mask] = k
    shapes = tuple(replace(_measured(view, one), label=k + 1) for k, one in enumerate(kept))
    return without_planes(planes, gone), shapes, shape_labels


def without_planes(found: PlaneSegmentation, gone: np.ndarray) -> PlaneSegmentation:
    """Return an image without the planes marked in ``gone`` (K,) bool."""
    if not gone.any():
        return found
    number = np.append(np.where(gone, -1, np.cumsum(~gone) - 1), -1).astype(found.labels.dtype)
    planes = found.planes.selected(~gone)
    return replace(found, labels=number[found.labels], planes=replace(
        planes, labels=np.arange(1, len(planes) + 1)))


def _joined(view: DepthView, found: list[FoundShape]) -> list[FoundShape]:
    """Merge pieces of one shape that are separated by a plane or a nearer object."""
    for k, one in enumerate(found):
        for other in found[k + 1:]:
            if one.fit.type is other.fit.type and (both := _as_one(view, one, other)):
                rest = [piece for piece in found if piece is not one and piece is not other]
                return _joined(view, [*rest, both])
    return found


def _as_one(view: DepthView, one: FoundShape, other: FoundShape) -> FoundShape | None:
    """Return the shape that explains both, or None."""
    large, small = sorted((one, other), key=lambda piece: -piece.members.sum())
    off = np.abs(shape_residuals(large.fit.shape, view.free_pixels(small.members)[0]))
    if np.median(off) > _FAR_DEVIATIONS:
        return None
    members = one.members | other.members
    pixels, _ = view.free_pixels(members)
    fit = fit_shape(large.fit.type, large.fit.shape, pixels)
    if fit is not None:  # pixels of the smaller piece that were outliers may fit now
        fit = fit_shape(fit.type, fit.shape, pixels)
    if fit is None or explained_share(fit, pixels) < _MIN_JOINT_SHARE:
        return None
    fit = fit_silhouette(fit, pixels, view.silhouette(members, view.around(members)))
    return on_image(view, FoundShape(fit, members, max(one.open_share, other.open_share),
                                     one.absorbed | other.absorbed))


def _measured(view: DepthView, found: FoundShape) -> Shape:
    """Return the result for a shape with its pixels."""
    fit, pixels = found.fit, view.points_in(found.window, found.mask)
    surface = surface_of(fit.shape, pixels.points_m)
    along_m = np.sort(surface.along_m)
    low_m, high_m = (float(along_m[round(share * (len(along_m) - 1))])
                     for share in _LENGTH_QUANTILES)
    share = explained_share(fit, view.free_pixels(found.members)[0])
    shape = Shape(
        fit.type, fit.shape[POSITION], fit.shape[AXIS], float(fit.shape[RADIUS]),
        float(fit.shape[HALF_ANGLE]), 0.0, int(found.mask.sum()),
        float(np.sqrt(np.mean(surface.distance_m**2))), fit.covariance,
        (1 - found.open_share) * share)
    if fit.type == ShapeType.CYLINDER:
        middle_m = shape.position_m + (low_m + high_m) / 2 * shape.axis
        return replace(shape, position_m=middle_m, length_m=high_m - low_m)
    return replace(shape, length_m=high_m) if fit.type == ShapeType.CONE else shape
