# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Detection of spheres, cylinders and cones in the pixels without a plane: the stages in order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from plane_detector.compilation import load_once
from plane_detector.config import Config, ShapesConfig
from plane_detector.segmentation.cells.pixel_regions import PixelRegions
from plane_detector.shapes.fitting import (
    FittedShape,
    Pixels,
    criterion,
    explained_share,
    fit_shape,
    fit_silhouette,
    is_determined,
    is_flat,
    plane_cost,
    plane_residuals,
    shape_misfit,
)
from plane_detector.shapes.labelling import (
    dilated_cells,
    label_shapes,
    on_image,
    open_share,
    seen_through_cost,
)
from plane_detector.shapes.models import MODELS, ShapeModel
from plane_detector.shapes.search import Candidate, agreeing, best_candidates, connected
from plane_detector.shapes.surface import DEVIATIONS
from plane_detector.shapes.surfels import smooth_components, surfels_of_grid
from plane_detector.shapes.views import DepthView, FoundShape, free_shares
from plane_detector.tracking.shape_tracker import ShapeTrack, update_shape_tracks
from plane_detector.types import CameraIntrinsics, PlaneSegmentation, Shape, ShapeType

# A plane is a facet of a shape if the shape explains this share of its pixels.
# tuned: benchmark shapes --first-seed 100 --scenes 40; flat from 0.7 times, at 1.4 times 2 of 197
# fewer are found.
_MIN_FACET_SHARE = 0.7
# Enough pixels to estimate a share.
_FACET_PIXELS = 300


def instead_of_planes(view: DepthView, found: FoundShape) -> FoundShape | None:
    """
    Return the shape together with the planes that it replaces, or None if the planes fit better.

    A plane is replaced completely or not at all. The shape must explain the pixels better than the
    planes by the Bayesian information criterion; unexplained pixels cost the same for both.
    """
    counts = view.label_counts(found.members)[:-1]
    absorbed = found.absorbed.copy()
    for k in np.flatnonzero(counts * view.is_open):
        facet = view.plane_pixels(int(k), _FACET_PIXELS)
        absorbed[k] = explained_share(found.fit, facet) >= _MIN_FACET_SHARE
    pixels, labels = view.free_pixels(found.members, absorbed)
    if not absorbed.any():
        return found if len(pixels.points_m) else None
    better = _shape_cost(found, pixels) < _plane_cost(view, pixels, labels)
    return replace(found, absorbed=absorbed) if better else None


def _shape_cost(found: FoundShape, pixels: Pixels) -> float:
    misfit = shape_misfit(found.fit.shape, pixels.points_m, pixels.noise_m)
    return criterion(misfit, len(found.fit.model.freedoms), pixels.independent)


def _plane_cost(view: DepthView, pixels: Pixels, labels: np.ndarray) -> float:
    """Return the criterion of the planes on the pixels; pixels without a plane are outliers."""
    residual = np.full(len(labels), DEVIATIONS)
    present = np.unique(labels[labels >= 0])
    for k in present:
        own = labels == k
        residual[own] = plane_residuals(view.planes[k], pixels)[own]
    misfit = float(np.minimum(residual**2, DEVIATIONS**2).mean())
    return criterion(misfit, 3 * len(present), pixels.independent)


# A plane with more than this share of the image is not a facet of a curved surface.
# tuned: benchmark shapes --first-seed 100 --scenes 40; at 1.7 times 1 of 197 more is found.
_MAX_FACET_SHARE = 0.06
# derived: the normals of fewer cells do not distinguish shapes.
_MIN_CELLS = 6
# A shape whose surface continues smoothly across more than this share of its border is part of a
# larger surface, such as an ellipsoid or a curtain.
# tuned: benchmark shapes --first-seed 100 --scenes 40; flat to 1.4 times, at 0.7 times 6 of 197
# fewer are found.
_MAX_OPEN_SHARE = 0.3
# A shape explains at least this share of the pixels of its cells.
# tuned: benchmark shapes --first-seed 100 --scenes 40; flat up to 0.86, at 0.56 two pieces of a
# torus are found as cylinders.
_MIN_EXPLAINED_SHARE = 0.8
# The search in a component ends after this many rejected shapes.
_MAX_FAILURES = 2
# A shape is rejected if its size is less certain than this, by the covariance of the fit.
# tuned: benchmark shapes --first-seed 100 --scenes 40; flat from 0.7 to 1.4 times.
_MAX_RADIUS_ERROR_SHARE, _MAX_ANGLE_ERROR_RAD = 0.25, np.radians(12.0)


def find_shapes(depth_m: np.ndarray, found: PlaneSegmentation, regions: PixelRegions,
                intrinsics: CameraIntrinsics, config: ShapesConfig,
                rng: np.random.Generator) -> tuple[PlaneSegmentation, tuple[Shape, ...]]:
    """
    Find spheres, cylinders and cones where there is no plane, or only facets of a curved surface.

    1. Cells without a plane become oriented points; smoothly connected cells form components.
    2. In each component the best hypothesis of each kind is found by RANSAC and fitted to its
       pixels. The kind with the lowest Bayesian information criterion is kept, unless a plane
       explains the pixels as well.
    3. A shape is rejected if its size is not determined, or if its surface continues across much
       of its border.
    4. Pieces of one shape are merged, and the pixels within the noise get its label.

    Parameters
    ----------
    depth_m : (H, W) floating
        Metres, NaN where invalid.
    found : PlaneSegmentation
        Planes of this depth, measured on these regions of 1/depth_m.
    regions : PixelRegions
    intrinsics : CameraIntrinsics
    config : ShapesConfig
    rng : numpy.random.Generator

    Returns
    -------
    PlaneSegmentation
        Without the planes that are facets of a shape; with K planes left, label K + i is shape i.
    shapes : tuple of Shape
        Largest first.

    """
    view = _view(depth_m, found, regions, intrinsics)
    models = [MODELS[ShapeType[name.upper()]] for name in config.wanted]
    return label_shapes(view, found, list(_search(view, models, config, rng)), config)


def _view(depth_m: np.ndarray, found: PlaneSegmentation, regions: PixelRegions,
          intrinsics: CameraIntrinsics) -> DepthView:
    grid, noise = regions.grid, regions.noise
    size = np.array([plane.inlier_count for plane in found.planes])
    return DepthView(np.ascontiguousarray(depth_m, np.float32),
                     np.ascontiguousarray(found.labels, np.int32), found.planes,
                     size < _MAX_FACET_SHARE * depth_m.size, noise, intrinsics, grid.shape,
                     grid.size_px, surfels_of_grid(grid, intrinsics, noise))


def _search(view: DepthView, models: Sequence[ShapeModel], config: ShapesConfig,
            rng: np.random.Generator) -> Iterator[FoundShape]:
    """Yield the shapes of all components."""
    min_pixels = config.min_share * view.labels.size
    share = free_shares(view.image, view.size_px, *view.shape)
    component = smooth_components(view.surfels.table, view.surfels.usable & (share > 0.5),
                                  view.shape[1])
    cells = np.bincount(component[component >= 0])
    for name in np.flatnonzero(cells >= _MIN_CELLS):
        left, failures = component == name, 0
        while (failures < _MAX_FAILURES and left.sum() >= _MIN_CELLS
               and view.surfels.count[left].sum() >= min_pixels):
            found = _next_shape(view, left, models, config, rng)
            if found is None:
                break
            left = left & ~found.members
            if found.open_share <= _MAX_OPEN_SHARE:
                yield found
            else:
                failures += 1


def _next_shape(view: DepthView, left: np.ndarray, models: Sequence[ShapeModel],
                config: ShapesConfig, rng: np.random.Generator) -> FoundShape | None:
    """Return the shape that explains most of the remaining cells, or None."""
    surfels, among = view.surfels, np.flatnonzero(left)
    if is_flat(view.free_pixels(left)[0]):
        return None
    candidates = best_candidates(surfels, among, models, config, rng)
    union = np.any([candidate.members for candidate in candidates] or [left & False], axis=0)
    if union.sum() < _MIN_CELLS:
        return None
    fit = _best_fit(view, candidates, union)
    if fit is None or not is_determined(fit, _MAX_RADIUS_ERROR_SHARE, _MAX_ANGLE_ERROR_RAD):
        return None
    agree = agreeing(surfels, fit.shape, among)
    if len(agree) < _MIN_CELLS:
        return None
    members = connected(surfels, fit.shape, agree, agree[np.argmax(union[agree])])
    if explained_share(fit, view.free_pixels(members)[0]) < _MIN_EXPLAINED_SHARE:
        return None
    found = instead_of_planes(view, FoundShape(fit, members, 0.0, view.is_open & False))
    if found is None:
        return None
    found = on_image(view, found)
    return replace(found, open_share=open_share(view, found))


def _best_fit(view: DepthView, candidates: Sequence[Candidate],
              cells: np.ndarray) -> FittedShape | None:
    """Return the candidate that best explains the pixels of some cells; None if a plane does."""
    pixels, _ = view.free_pixels(cells)
    around, best, lowest = dilated_cells(view, cells), None, plane_cost(pixels)
    silhouette = None
    alone = [fit for one in candidates if (fit := fit_shape(one.model, one.shape, pixels))]
    for fit in sorted(alone, key=lambda one: one.cost):
        if fit.cost >= lowest:  # silhouette and rays can only add to it
            break
        silhouette = silhouette or view.silhouette(cells, around)
        fit = fit_silhouette(fit, pixels, silhouette)
        cost = fit.cost + seen_through_cost(view, fit, cells, around)
        if cost < lowest:
            best, lowest = fit, cost
    return best


Found = tuple[PlaneSegmentation, tuple[Shape, ...], tuple[int, ...]]


class ShapeDetector:
    """Finds the shapes that the settings request; must be called with every image in order."""

    def __init__(self) -> None:
        self._tracks: tuple[ShapeTrack, ...] = ()

    def reset(self) -> None:
        """Discard all known shapes."""
        self._tracks = ()

    def detect(self, depth_m: np.ndarray, planes: PlaneSegmentation, regions: PixelRegions,
               intrinsics: CameraIntrinsics, config: Config, in_metres: bool) -> Found:
        """
        Return planes, shapes and the labels of the shapes.

        Parameters
        ----------
        depth_m : (H, W) floating
            NaN where invalid.
        planes : PlaneSegmentation
            Planes of this depth.
        regions : PixelRegions
            The regions that they were measured on, in 1/m.
        intrinsics : CameraIntrinsics
        config : Config
            Its ``shapes``, ``tracking`` and the seed of ``ransac``.
        in_metres : bool
            Whether depth is in metres; otherwise no shapes are searched for.

        Returns
        -------
        PlaneSegmentation
            As returned by :func:`find_shapes`; unchanged if no shapes are requested.
        tuple of Shape
            Largest first.
        tuple of int
            Label of each shape, above 0; empty if shapes are not tracked.

        """
        if not (config.shapes.wanted and in_metres):
            return planes, (), ()
        load_once('shapes')
        planes, shapes = find_shapes(depth_m, planes, regions, intrinsics, config.shapes,
                                     np.random.default_rng(config.ransac.seed))
        if not config.tracking.enabled:
            self.reset()
            return planes, shapes, ()
        self._tracks, labels = update_shape_tracks(
            self._tracks, shapes, planes.labels, len(planes.planes), config.tracking.keep_frames)
        return planes, shapes, labels
