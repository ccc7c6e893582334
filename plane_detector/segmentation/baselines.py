# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Baselines of the segmentation: the paper's method, and RANSAC without clustering.

The method of "Improved Plane Detection in 3D Reconstruction from 2D Images" (J. Quan) removes
planes from the point cloud one by one with pyRANSAC-3D and one metric threshold; then DBSCAN on
the points of each plane removes artefacts. pyransac3d is optional and only imported here.
"""

from __future__ import annotations

import random
from typing import Any

import numpy as np

from plane_detector._runtime.process import one_thread
from plane_detector._runtime.stopping import raise_if_stopped
from plane_detector.config import Config, PaperConfig
from plane_detector.geometry.disparity import to_depth, to_disparity, zero_filled
from plane_detector.geometry.projection import depth_to_points
from plane_detector.segmentation.cells.grid import (
    CellGrid,
    DisparityImage,
    build_cell_grid,
    fit_planes,
)
from plane_detector.segmentation.cells.model import (
    MAX_DEVIATIONS,
    Frame,
    PixelRegions,
    count_labels,
    relabel_sequential,
)
from plane_detector.segmentation.cells.noise import Noise, estimate_noise
from plane_detector.segmentation.search.ransac import add_planes, no_planes
from plane_detector.segmentation.segment import metric_noise_floor
from plane_detector.types import CameraIntrinsics


@one_thread()
def segment_by_paper(disparity: np.ndarray, intrinsics: CameraIntrinsics, noise_floor: Noise,
                     config: Config, rng: np.random.Generator | None = None) -> PixelRegions:
    """
    Segment with the paper's method; same interface as :func:`segment`.

    Parameters
    ----------
    disparity : (H, W) floating
        1/z in 1/metres, not finite where invalid: its thresholds are metric.
    intrinsics : CameraIntrinsics
    noise_floor : Noise
    config : Config
        Its ``segmentation`` and ``paper`` are used.
    rng : numpy.random.Generator, optional
        Default: seeded with ``config.ransac.seed``.

    Returns
    -------
    PixelRegions
        Each plane is refitted to the cells that it fills.

    Raises
    ------
    ModuleNotFoundError
        pyransac3d is not installed.

    """
    rng = rng or np.random.default_rng(config.ransac.seed)
    image = DisparityImage(*zero_filled(disparity))
    grid = build_cell_grid(image)
    labels = paper_labels(to_depth(disparity), intrinsics, config, rng)
    planes, labels = fit_labels(grid, labels)
    return PixelRegions(image.values, labels, planes, grid, estimate_noise(grid, noise_floor))


def fit_labels(grid: CellGrid, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Fit planes to labels by the cells that they fill.

    Parameters
    ----------
    grid : CellGrid
    labels : (H, W) int32
        -1 for no plane and where invalid.

    Returns
    -------
    planes : (K, 3) float64
        In the coordinates of the cells.
    labels : (H, W) int32
        Without those that fill too few cells.

    """
    count = count_labels(grid, labels, int(labels.max(initial=-1)) + 1)
    whole = (count == grid.moments[:, :1]) & grid.usable[:, None]
    planes = fit_planes(whole.T.astype(float) @ grid.moments)
    kept = np.flatnonzero(np.isfinite(planes).all(axis=1))
    return planes[kept], relabel_sequential(labels, kept, len(planes))


def paper_labels(depth_m: np.ndarray, intrinsics: CameraIntrinsics, config: Config,
                 rng: np.random.Generator, cluster: bool = True) -> np.ndarray:
    """
    Label pixels with the paper's method.

    Parameters
    ----------
    depth_m : (H, W) floating
    intrinsics : CameraIntrinsics
    config, rng
        As of :func:`segment_by_paper`.
    cluster : bool
        False: without DBSCAN, the planes of RANSAC alone.

    Returns
    -------
    (H, W) int32
        Plane of each pixel, -1 none.

    Raises
    ------
    ModuleNotFoundError
        pyransac3d is not installed.

    """
    points_m = depth_to_points(np.asarray(depth_m, np.float32), intrinsics)
    stride = int(np.ceil(np.sqrt(depth_m.size / config.paper.max_points)))
    seen = np.isfinite(points_m[::stride, ::stride, 2])
    seen_m = points_m[::stride, ::stride][seen]
    min_points = max(3, config.segmentation.min_plane_share * seen.size)
    found = _peel(seen_m, min_points, config, rng)
    if cluster:
        found = [(equation, members[piece]) for equation, members in found
                 for piece in _large_clusters(seen_m[members], min_points, config.paper)]
    thinned, places = np.full(seen.shape, -1, np.int32), np.flatnonzero(seen)
    for k, (_, members) in enumerate(found):
        thinned.flat[places[members]] = k
    labels = thinned.repeat(stride, axis=0).repeat(stride, axis=1)
    labels = labels[:depth_m.shape[0], :depth_m.shape[1]].copy()
    return _near_planes(labels, points_m, [equation for equation, _ in found], config.paper)


def _near_planes(labels: np.ndarray, points_m: np.ndarray, equations: list[Any],
                 paper: PaperConfig) -> np.ndarray:
    """Remove the labels of pixels that are not near the plane of their subsampled point."""
    for k, equation in enumerate(equations):
        distance_m = np.abs(points_m @ np.array(equation[:3]) + equation[3])
        labels[(labels == k) & ~(distance_m <= paper.distance_threshold)] = -1
    return labels


def _peel(points_m: np.ndarray, min_points: float, config: Config,
          rng: np.random.Generator) -> list[tuple[Any, np.ndarray]]:
    """Fit the best plane, remove its inliers, repeat: equations (4,) and indices of inliers."""
    try:
        from pyransac3d import Plane
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError('segmentation.method paper needs the package pyransac3d: '
                                  'pip install pyransac3d') from error
    left, found = np.arange(len(points_m)), []
    state = random.getstate()
    random.seed(int(rng.integers(2**31)))  # pyransac3d draws from the global generator
    try:
        while len(found) < config.segmentation.max_planes and len(left) >= min_points:
            equation, inliers = _fit(Plane, points_m[left], config.paper)
            if len(inliers) < min_points:
                break
            found.append((equation, left[inliers]))
            left = np.delete(left, inliers)
    finally:
        random.setstate(state)
    return found


def _fit(plane: Any, points_m: np.ndarray, paper: PaperConfig) -> tuple[Any, np.ndarray]:
    """
    Return the equation (4,) of the best plane and the indices of its inliers.

    pyransac3d is called for one iteration at a time, so that it can be stopped; the result is the
    same as that of a single call.
    """
    equation, inliers = np.zeros(4), np.zeros(0, np.int64)
    for _ in range(paper.max_iterations):
        raise_if_stopped()
        found = plane().fit(points_m, paper.distance_threshold, maxIteration=1)
        if len(found[1]) > len(inliers):
            equation, inliers = found
    return equation, inliers


def _large_clusters(points_m: np.ndarray, min_points: float,
                    paper: PaperConfig) -> list[np.ndarray]:
    """Return the indices of the points of each density cluster that is large enough."""
    clusters = point_clusters(points_m, paper.dbscan_eps, paper.dbscan_min_samples)
    sizes = np.bincount(clusters[clusters >= 0])
    return [np.flatnonzero(clusters == k) for k in np.flatnonzero(sizes >= min_points)]


def point_clusters(points_m: np.ndarray, eps_m: float, min_samples: int) -> np.ndarray:
    """
    Cluster points by density (Ester et al. 1996), with the result of scikit-learn's DBSCAN.

    Scikit-learn keeps the neighbours of all points in memory, 5 GB for 20 000 close points. Here
    only those of one point are kept, and the search can be stopped.

    Parameters
    ----------
    points_m : (n, 3) floating
    eps_m : float
        Radius of the neighbourhood.
    min_samples : int
        Points in the neighbourhood of a core point, including itself.

    Returns
    -------
    (n,) int64
        Cluster of each point, in the order of their first core points; -1 for noise. A border
        point belongs to the first of the clusters that reach it.

    """
    labels, count = np.full(len(points_m), -1), 0
    if not len(points_m):
        return labels
    from scipy.spatial import cKDTree  # only this method needs scipy, which takes 46 MB
    tree = cKDTree(points_m)
    is_core = tree.query_ball_point(points_m, eps_m, return_length=True) >= min_samples
    for first in np.flatnonzero(is_core):
        if labels[first] >= 0:
            continue
        labels[first], waiting = count, [first]
        while waiting:
            raise_if_stopped()
            near = np.array(tree.query_ball_point(points_m[waiting.pop()], eps_m))
            new = near[labels[near] < 0]
            labels[new] = count
            waiting.extend(new[is_core[new]])
        count += 1
    return labels


@one_thread()
def ransac_alone(depth_m: np.ndarray) -> np.ndarray:
    """
    Label pixels by sequential RANSAC without clustering, to show the effect of clustering.

    A plane takes inliers from the whole image; there is no merging, no competition.

    Parameters
    ----------
    depth_m : (H, W) floating
        Metres, NaN invalid.

    Returns
    -------
    (H, W) int32
        Plane of each pixel, -1 none.

    """
    config = Config()
    image = DisparityImage(*zero_filled(to_disparity(depth_m)))
    grid = build_cell_grid(image)
    noise = estimate_noise(grid, metric_noise_floor(config))
    frame = Frame(image, grid, noise, config.segmentation.min_plane_share * depth_m.size, config,
                  np.random.default_rng(config.ransac.seed))
    planes = add_planes(frame, no_planes(grid), config.segmentation.max_planes).coefficients
    variance = noise.mean_sigma**2 + noise.pixel_sigma**2 + noise.variance_floor(image.values)
    labels = np.full(image.valid.shape, -1, np.int32)
    v, u = np.ogrid[:labels.shape[0], :labels.shape[1]]
    for k, (a, b, c) in enumerate(grid.planes_in_pixels(planes)):
        error = (image.values - (a * u + b * v + c)) ** 2
        labels[image.valid & (labels < 0) & (error < MAX_DEVIATIONS**2 * variance)] = k
    return labels
