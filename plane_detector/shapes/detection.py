# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Detection of spheres, cylinders and cones in the pixels without a plane: the stages in order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from plane_detector.config import ShapesConfig
from plane_detector.segmentation.cells.pixel_regions import PixelRegions
from plane_detector.shapes.competition import instead_of_planes
from plane_detector.shapes.extent import dilated_cells, on_image, open_share, seen_through_cost
from plane_detector.shapes.labelling import label_shapes
from plane_detector.shapes.models import MODELS, ShapeModel
from plane_detector.shapes.refinement import (
    FittedShape,
    explained_share,
    fit_shape,
    fit_silhouette,
    is_determined,
    is_flat,
    plane_cost,
)
from plane_detector.shapes.search import (
    Candidate,
    agreeing,
    best_candidates,
    connected,
)
from plane_detector.shapes.surfels import smooth_components, surfels_of_grid
from plane_detector.shapes.views import DepthView, FoundShape
from plane_detector.shapes.windows import free_shares
from plane_detector.types import CameraIntrinsics, PlaneSegmentation, Shape, ShapeType

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
