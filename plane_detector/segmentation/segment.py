# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Many planes: hypothesise, take the largest, refine, split by DBSCAN, repeat, label every pixel.

Everything works on 1/z over the picture, where planes are affine, where the noise of stereo and
of depth networks is near constant, and where an unknown scale and shift of a network's disparity
changes nothing about which pixels form a plane.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from plane_detector.config import Config
from plane_detector.geometry.projection import check_depth
from plane_detector.planes.measurement import measure_planes
from plane_detector.segmentation.baselines import paper_labels
from plane_detector.segmentation.cells.grid import (
    CellGrid,
    fit_planes,
    make_cells,
    picture_coordinates,
)
from plane_detector.segmentation.cells.labels import count_labels, renumber, without
from plane_detector.segmentation.cells.noise import Noise, estimate_noise, with_rounding
from plane_detector.segmentation.fine_pass import MIN_CELL_SHARE, add_narrow
from plane_detector.segmentation.pixels.creases import straighten
from plane_detector.segmentation.pixels.labelling import label_pixels
from plane_detector.segmentation.regions.bends import find_bent, join_bowed
from plane_detector.segmentation.regions.curvature import drop_curved
from plane_detector.segmentation.regions.depth_steps import split_at_steps
from plane_detector.segmentation.regions.icm import relabel
from plane_detector.segmentation.regions.merging import merge_patches
from plane_detector.segmentation.regions.occlusion import join_hidden
from plane_detector.segmentation.regions.refinement import refine_borders
from plane_detector.segmentation.search.plane_search import find_patches
from plane_detector.segmentation.threads import one_blas_thread
from plane_detector.types import CameraIntrinsics, PlaneSegmentation

DEFAULTS = Config()
Refine = Callable[[np.ndarray], np.ndarray]
# The range of a disparity of unknown unit, and what its exact planes may stray by.
RANGE_QUANTILES = (0.02, 0.98)
RELATIVE_FLOOR = 1e-4
# No camera sees nearer; its inverse would drown the picture in rounding.
LEAST_DEPTH_M = 1e-3


@one_blas_thread
def segment_planes(depth_m: np.ndarray, intrinsics: CameraIntrinsics, config: Config | None = None,
                   *, disparity_noise: float = 0.0, rng: np.random.Generator | None = None,
                   refine: Refine | None = None) -> PlaneSegmentation:
    """
    Find the planes of a depth image and label its pixels.

    Parameters
    ----------
    depth_m : (H, W) floating
        Metres along the optical axis; NaN, infinity, zero and less are invalid.
    intrinsics : CameraIntrinsics
        Of a picture of that size.
    config : Config, optional
        Its ``segmentation``, ``ransac``, ``dbscan`` and ``paper`` are used.
    disparity_noise : float
        What the source of the depth is known for, per metre; 0 when nothing is known. The noise
        is estimated from the picture and taken to be at least this.
    rng : numpy.random.Generator, optional
        Default: seeded with ``config.ransac.seed``.
    refine : callable, optional
        Takes the labels (H, W) int32 and returns better ones, before the planes are measured.

    Returns
    -------
    PlaneSegmentation
        The planes, largest first, and the labels. No plane is no error.

    Raises
    ------
    ValueError
        The depth image is none, or of another size than the intrinsics say.

    """
    config = config or DEFAULTS
    rng = rng or np.random.default_rng(config.ransac.seed)
    check_depth(depth_m, intrinsics)
    if config.segmentation.method == 'paper':
        labels, _ = paper_labels(depth_m, intrinsics, config, rng)
        return measure_labels(depth_m, labels, intrinsics, config, disparity_noise)
    disparity, valid = to_disparity(depth_m)
    grid = make_cells(disparity, valid)
    known = config.segmentation.disparity_noise or disparity_noise
    least = with_rounding(Noise(config.ransac.noise_floor, known=known), disparity, valid)
    labels, planes, noise = _label(disparity, valid, grid, least, config, rng)
    labels = _refined(labels, valid, refine)
    min_pixels = config.segmentation.min_plane_share * depth_m.size
    planes, labels = measure_planes(disparity, grid, labels, planes, noise, intrinsics, min_pixels)
    return PlaneSegmentation(planes, labels, noise.mean)


@one_blas_thread
def segment_disparity(disparity: np.ndarray, config: Config, *, disparity_noise: float = 0.0,
                      rng: np.random.Generator | None = None) -> np.ndarray:
    """
    Find which pixels of a disparity image of unknown scale and shift form planes.

    Parameters
    ----------
    disparity : (H, W) floating
        Affine in 1/depth, in any unit; not finite where invalid.
    config : Config
    disparity_noise : float
        What the network is known for, in the same unit.
    rng : numpy.random.Generator, optional
        Default: seeded with ``config.ransac.seed``.

    Returns
    -------
    (H, W) int32
        Plane of each pixel, -1 none.

    """
    rng = rng or np.random.default_rng(config.ransac.seed)
    valid = np.isfinite(disparity)
    disparity = np.where(valid, disparity, 0).astype(np.float32)
    grid = make_cells(disparity, valid)
    floor = RELATIVE_FLOOR * disparity_range(np.where(valid, disparity, np.nan))
    least = with_rounding(Noise(0.0, floor, disparity_noise), disparity, valid)
    return _label(disparity, valid, grid, least, config, rng)[0]


def disparity_range(disparity: np.ndarray) -> float:
    """Return the range that all but the outermost finite values lie in; above 0."""
    sample = disparity[::4, ::4]
    sample = sample[np.isfinite(sample)]
    low, high = np.quantile(sample, RANGE_QUANTILES) if sample.size else (0.0, 0.0)
    return max(float(high - low), float(np.finfo(np.float32).tiny))


@one_blas_thread
def measure_labels(depth_m: np.ndarray, labels: np.ndarray, intrinsics: CameraIntrinsics,
                   config: Config, disparity_noise: float = 0.0,
                   refine: Refine | None = None) -> PlaneSegmentation:
    """
    Measure planes whose pixels are known, in the unit of the depth.

    Parameters
    ----------
    depth_m : (H, W) floating
        Not finite or not positive is invalid.
    labels : (H, W) int32
        Plane of each pixel, -1 none.
    intrinsics : CameraIntrinsics
    config : Config
    disparity_noise : float
        As in :func:`segment_planes`.
    refine : callable, optional
        As in :func:`segment_planes`: the planes are fitted to the labels as they were before.

    Returns
    -------
    PlaneSegmentation

    """
    disparity, valid = to_disparity(depth_m)
    labels = np.where(valid, labels, -1)
    grid = make_cells(disparity, valid)
    noise = estimate_noise(grid, Noise(config.ransac.noise_floor, known=disparity_noise))
    planes, labels = _fit_labels(grid, labels)
    labels = _refined(labels, valid, refine)
    min_pixels = config.segmentation.min_plane_share * depth_m.size
    measured, labels = measure_planes(disparity, grid, labels, planes, noise, intrinsics,
                                      min_pixels)
    return PlaneSegmentation(measured, labels, noise.mean)


def _refined(labels: np.ndarray, valid: np.ndarray, refine: Refine | None) -> np.ndarray:
    return np.where(valid, refine(labels), -1) if refine else labels


def _fit_labels(grid: CellGrid, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fit planes to labels by the cells that they fill; labels that fill too few go."""
    count = count_labels(grid, labels, int(labels.max(initial=-1)) + 1)
    whole = (count == grid.moments[:, :1]) & grid.usable[:, None]
    planes = fit_planes(whole.T.astype(float) @ grid.moments)
    kept = np.flatnonzero(np.isfinite(planes).all(axis=1))
    return planes[kept], renumber(labels, kept, len(planes))


@one_blas_thread
def ransac_alone(depth_m: np.ndarray, intrinsics: CameraIntrinsics,
                 config: Config | None = None) -> np.ndarray:
    """
    Label pixels by RANSAC without clustering, to show what clustering is good for.

    Planes take their inliers wherever they are; there is no DBSCAN, no merging, no competition.

    Parameters
    ----------
    depth_m, intrinsics, config
        As in :func:`segment_planes`.

    Returns
    -------
    (H, W) int32
        Plane of each pixel, -1 none.

    """
    config = config or DEFAULTS
    check_depth(depth_m, intrinsics)
    disparity, valid = to_disparity(depth_m)
    grid = make_cells(disparity, valid)
    least = Noise(config.ransac.noise_floor, known=config.segmentation.disparity_noise)
    min_pixels = config.segmentation.min_plane_share * depth_m.size
    rng = np.random.default_rng(config.ransac.seed)
    _, patches, noise = find_patches(grid, least, min_pixels, config, None, rng)
    return np.where(valid, _nearest_plane(disparity, patches.planes, noise,
                                          config.ransac.inlier_threshold), -1)


def _nearest_plane(disparity: np.ndarray, planes: np.ndarray, noise: Noise,
                   threshold: float) -> np.ndarray:
    """Return for each pixel the plane that it lies nearest to, -1 beyond the threshold."""
    x, y = picture_coordinates(disparity.shape)
    best = threshold**2 * (noise.mean**2 + noise.grain**2 + noise.floor(disparity))
    labels = np.full(disparity.shape, -1, np.int32)
    for k, (a, b, c) in enumerate(planes):
        error = (disparity - (a * x + b * y[:, None] + c)) ** 2
        labels[error < best] = k
        best = np.minimum(best, error)
    return labels


def to_disparity(depth_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return 1/depth, 0 where invalid, (H, W) float32, and where it is valid, (H, W) bool."""
    valid = (depth_m >= LEAST_DEPTH_M) & (depth_m < np.inf)
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        disparity = np.reciprocal(depth_m, dtype=np.float32)
    if not valid.all():
        disparity = np.where(valid, disparity, np.float32(0))
    return disparity, valid


def _label(disparity: np.ndarray, valid: np.ndarray, grid: CellGrid, least: Noise,
           config: Config, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, Noise]:
    """Return labels (H, W), planes (K, 3) of the cells' coordinates, and the noise."""
    threshold = config.ransac.inlier_threshold
    min_cell_pixels = MIN_CELL_SHARE * config.segmentation.min_plane_share * disparity.size
    model, patches, noise = find_patches(grid, least, min_cell_pixels, config, config.dbscan, rng)
    patches = relabel(model, patches, threshold, min_cell_pixels, config.dbscan)
    patches = join_hidden(model, merge_patches(model, patches, noise), noise)
    if noise.is_exact(grid.typical_disparity):
        patches = drop_curved(model, patches, noise)
    else:
        patches = split_at_steps(disparity, valid, model, patches, noise, min_cell_pixels)
        patches = refine_borders(model, straighten(model, patches, threshold), noise)
        patches = join_bowed(model, patches, noise)
    labels = label_pixels(disparity, valid, model, patches, noise, threshold)
    labels, planes = add_narrow(disparity, valid, labels, model, noise, patches.planes, config,
                                rng)
    # Until here the facets of curved things hold their place, lest others grow into it.
    return *without(labels, planes, find_bent(model, patches, noise)), noise
