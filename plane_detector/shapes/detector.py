# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Detection of spheres, cylinders and cones in the pixels without a plane: the stages in order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from plane_detector._runtime.compilation import load_once
from plane_detector.config import Config
from plane_detector.segmentation.cells.model import PixelRegions
from plane_detector.shapes.fitting import (
    FittedShape,
    criterion,
    explained_share,
    fit_shape,
    fit_silhouette,
    limited_square,
    plane_misfit,
    plane_residuals,
    shape_misfit,
)
from plane_detector.shapes.labelling import (
    MIN_SHARE,
    PlanesAndShapes,
    label_shapes,
    on_image,
    open_share,
)
from plane_detector.shapes.search import Candidate, agreeing, best_candidates, connected
from plane_detector.shapes.surface import AXIS, DEVIATIONS, FREEDOMS, surface_of
from plane_detector.shapes.surfels import smooth_components, surfels_of_grid
from plane_detector.shapes.views import DepthView, FoundShape
from plane_detector.tracking.shape_tracker import ShapeTrack, update_shape_tracks
from plane_detector.types import (
    CameraIntrinsics,
    PlaneSegmentation,
    ShapeType,
)

# A plane with more than this share of the image is not a facet of a curved surface.
# tuned: benchmark shapes --first-seed 100 --scenes 40; at 1.7 times 1 of 197 more is found.
_MAX_FACET_SHARE = 0.06
# A plane is a facet of a shape if the shape explains this share of its pixels.
# tuned: benchmark shapes --first-seed 100 --scenes 40; flat from 0.7 times, at 1.4 times 2 of 197
# fewer are found.
_MIN_FACET_SHARE = 0.7
# Enough pixels to estimate a share.
_FACET_PIXELS = 300
# chosen: the normals of fewer cells do not distinguish shapes.
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


class ShapeDetector:
    """Finds the shapes that the settings request; must be called with every image in order."""

    def __init__(self) -> None:
        self._tracks: tuple[ShapeTrack, ...] = ()
        self._size: tuple[int, int] | None = None

    def reset(self) -> None:
        """Discard all known shapes."""
        self._tracks = ()

    def detect(self, depth_m: np.ndarray, planes: PlaneSegmentation, regions: PixelRegions,
               intrinsics: CameraIntrinsics, config: Config) -> PlanesAndShapes:
        """
        Return planes and shapes as :func:`find_shapes` does; tracked shapes keep their labels.

        The depth is in metres, and shapes are requested.
        """
        load_once('shapes')
        planes, shapes, shape_labels = find_shapes(
            depth_m, planes, regions, intrinsics, config.shapes.wanted,
            np.random.default_rng(config.ransac.seed))
        if not config.tracking.enabled:
            self.reset()
            return planes, shapes, shape_labels
        if shape_labels.shape != self._size:  # their pixels are from images of another size
            self.reset()
            self._size = shape_labels.shape
        self._tracks, labels = update_shape_tracks(
            self._tracks, shapes, shape_labels, config.tracking.keep_frames)
        shapes = tuple(replace(shape, label=label)
                       for shape, label in zip(shapes, labels, strict=True))
        return planes, shapes, shape_labels


def find_shapes(depth_m: np.ndarray, found: PlaneSegmentation, regions: PixelRegions,
                intrinsics: CameraIntrinsics, wanted: Sequence[str],
                rng: np.random.Generator) -> PlanesAndShapes:
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
    wanted : sequence of str
        Of sphere, cylinder and cone.
    rng : numpy.random.Generator

    Returns
    -------
    PlaneSegmentation
        Without the planes that are facets of a shape.
    shapes : tuple of Shape
        Largest first, labelled from 1 on.
    shape_labels : (H, W) int32
        Index into the shapes, -1 none.

    """
    grid, noise = regions.grid, regions.noise
    view = DepthView(np.ascontiguousarray(depth_m, np.float32), found.labels, found.planes,
                     found.planes.counts < _MAX_FACET_SHARE * depth_m.size, noise, intrinsics,
                     grid.size_px, surfels_of_grid(grid, intrinsics, noise))
    kinds = [ShapeType[name.upper()] for name in wanted]
    return label_shapes(view, found, list(_search(view, kinds, rng)))


def _search(view: DepthView, kinds: Sequence[ShapeType],
            rng: np.random.Generator) -> Iterator[FoundShape]:
    """Yield the shapes of all components."""
    min_pixels = MIN_SHARE * view.labels.size
    component = smooth_components(view.surfels, view.surfels.usable & (view.free_shares() > 0.5))
    cells = np.bincount(component[component >= 0])
    for name in np.flatnonzero(cells >= _MIN_CELLS):
        left, failures = component == name, 0
        while (failures < _MAX_FAILURES and left.sum() >= _MIN_CELLS
               and view.surfels.count[left].sum() >= min_pixels):
            found = _next_shape(view, left, kinds, rng)
            if found is None:
                break
            left = left & ~found.members
            if found.open_share <= _MAX_OPEN_SHARE:
                yield found
            else:
                failures += 1


def _next_shape(view: DepthView, left: np.ndarray, kinds: Sequence[ShapeType],
                rng: np.random.Generator) -> FoundShape | None:
    """Return the shape that explains most of the remaining cells, or None."""
    surfels, among = view.surfels, np.flatnonzero(left)
    if plane_misfit(view.free_pixels(left)[0]) <= 1.0:  # flat within the noise
        return None
    candidates = best_candidates(surfels, among, kinds, rng)
    union = np.any([candidate.members for candidate in candidates] or [left & False], axis=0)
    if union.sum() < _MIN_CELLS:
        return None
    fit = _best_fit(view, candidates, union)
    if fit is None or not fit.is_determined:
        return None
    agree = agreeing(fit.shape, surfels.table, among)
    if len(agree) < _MIN_CELLS:
        return None
    members = connected(surfels, fit.shape, agree, agree[np.argmax(union[agree])])
    if explained_share(fit, view.free_pixels(members)[0]) < _MIN_EXPLAINED_SHARE:
        return None
    found = _instead_of_planes(view, FoundShape(fit, members, 0.0, view.is_open & False))
    if found is None:
        return None
    found = on_image(view, found)
    return replace(found, open_share=open_share(view, found))


def _best_fit(view: DepthView, candidates: Sequence[Candidate],
              cells: np.ndarray) -> FittedShape | None:
    """Return the candidate that best explains the pixels of some cells; None if a plane does."""
    pixels, _ = view.free_pixels(cells)
    around, best = view.around(cells), None
    lowest = criterion(plane_misfit(pixels), 3, pixels.independent)
    alone = [fit for one in candidates if (fit := fit_shape(one.type, one.shape, pixels))]
    silhouette = None
    for fit in sorted(alone, key=lambda one: one.cost):
        if fit.cost >= lowest:  # silhouette and rays can only add to it
            break
        silhouette = silhouette or view.silhouette(cells, around)
        fit = fit_silhouette(fit, pixels, silhouette)
        along_m = surface_of(fit.shape, view.surfels.points_m[cells]).along_m
        ends_m = (along_m.min(), along_m.max()) if fit.shape[AXIS].any() else (-np.inf, np.inf)
        cost = fit.cost + view.seen_through_cost(fit.shape, around, ends_m)
        if cost < lowest:
            best, lowest = fit, cost
    return best


def _instead_of_planes(view: DepthView, found: FoundShape) -> FoundShape | None:
    """
    Return the shape together with the planes that it replaces, or None if the planes fit better.

    A plane is replaced completely or not at all. The Bayesian information criterion decides;
    unexplained pixels cost the same for both.
    """
    labels, absorbed = view.free_pixels(found.members)[1], found.absorbed.copy()
    for k in np.unique(labels[labels >= 0]):
        facet = view.plane_pixels(int(k), _FACET_PIXELS)
        absorbed[k] = explained_share(found.fit, facet) >= _MIN_FACET_SHARE
    pixels, labels = view.free_pixels(found.members, absorbed)
    if not absorbed.any():
        return found if len(pixels.points_m) else None
    residual = np.full(len(labels), DEVIATIONS)  # pixels without a plane are outliers
    present = np.unique(labels[labels >= 0])
    for k in present:
        own = labels == k
        residual[own] = plane_residuals(view.planes[k], pixels)[own]
    of_planes = criterion(limited_square(residual), 3 * len(present), pixels.independent)
    of_shape = criterion(shape_misfit(found.fit.shape, pixels), len(FREEDOMS[found.fit.type]),
                         pixels.independent)
    return replace(found, absorbed=absorbed) if of_shape < of_planes else None
