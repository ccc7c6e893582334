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

from plane_detector.config import Config, PaperConfig
from plane_detector.geometry.disparity import to_depth, to_disparity, zero_filled
from plane_detector.geometry.projection import depth_to_points
from plane_detector.segmentation.cells.grid import (
    CellGrid,
    DisparityImage,
    build_cell_grid,
    image_coordinates,
)
from plane_detector.segmentation.cells.labels import count_labels, relabel_sequential
from plane_detector.segmentation.cells.noise import Noise, estimate_noise
from plane_detector.segmentation.cells.pixel_regions import PixelRegions
from plane_detector.segmentation.cells.plane_fit import fit_planes
from plane_detector.segmentation.search.frame import Frame
from plane_detector.segmentation.search.point_clusters import point_clusters
from plane_detector.segmentation.search.ransac import add_planes, no_planes
from plane_detector.segmentation.segment import metric_noise_floor
from plane_detector.stopping import raise_if_stopped
from plane_detector.threads import one_blas_thread
from plane_detector.types import CameraIntrinsics


@one_blas_thread
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
    labels = paper_labels(to_depth(disparity), intrinsics, config, rng)
    image = DisparityImage(*zero_filled(np.ascontiguousarray(disparity)))
    grid = build_cell_grid(image)
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
    config : Config
        Its ``segmentation`` and ``paper`` are used.
    rng : numpy.random.Generator
        Seeds pyransac3d.
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
    thinned_m = points_m[::stride, ::stride]
    thinned = np.full(thinned_m.shape[:2], -1, np.int32)
    seen = np.isfinite(thinned_m[..., 2])
    min_points = max(3, config.segmentation.min_plane_share * thinned.size)
    thinned[seen], equations = _peel(thinned_m[seen], min_points, config, rng)
    if cluster:
        thinned[seen], equations = _clusters(thinned[seen], thinned_m[seen], equations,
                                             min_points, config.paper)
    return _to_all_pixels(thinned, points_m, equations, stride, config.paper.distance_threshold)


def _to_all_pixels(thinned: np.ndarray, points_m: np.ndarray, equations: np.ndarray, stride: int,
                   threshold_m: float) -> np.ndarray:
    """Label each pixel like its subsampled point if it is near that point's plane."""
    labels = thinned.repeat(stride, axis=0).repeat(stride, axis=1)[:len(points_m)]
    labels = np.ascontiguousarray(labels[:, :points_m.shape[1]])
    inside = labels >= 0
    equation = equations[labels[inside]]
    distance_m = np.abs((points_m[inside] * equation[:, :3]).sum(axis=1) + equation[:, 3])
    labels[inside] = np.where(distance_m <= threshold_m, labels[inside], -1)
    return labels


def _peel(points_m: np.ndarray, min_points: float, config: Config,
          rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Fit the best plane, remove its inliers, repeat: labels (n,) and equations (K, 4)."""
    try:
        from pyransac3d import Plane
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError('segmentation.method paper needs the package pyransac3d: '
                                  'pip install pyransac3d') from error
    labels, equations = np.full(len(points_m), -1, np.int32), []
    state = random.getstate()
    random.seed(int(rng.integers(2**31)))  # pyransac3d draws from the global generator
    try:
        while len(equations) < config.segmentation.max_planes:
            left = np.flatnonzero(labels < 0)
            if len(left) < min_points:
                break
            equation, inliers = _fit(Plane, points_m[left], config.paper)
            if len(inliers) < min_points:
                break
            labels[left[inliers]] = len(equations)
            equations.append(np.asarray(equation, float))
    finally:
        random.setstate(state)
    return labels, np.array(equations).reshape(-1, 4)


def _fit(plane: Any, points_m: np.ndarray, paper: PaperConfig) -> tuple[Any, np.ndarray]:
    """
    Return the equation (4,) of the best plane and the indices of its inliers.

    pyransac3d is called for one iteration at a time, so that it can be stopped; the result is that
    of a single call.
    """
    equation, inliers = np.zeros(4), np.zeros(0, np.int64)
    for _ in range(paper.max_iterations):
        raise_if_stopped()
        found = plane().fit(points_m, paper.distance_threshold, maxIteration=1)
        if len(found[1]) > len(inliers):
            equation, inliers = found
    return equation, inliers


def _clusters(labels: np.ndarray, points_m: np.ndarray, equations: np.ndarray,
              min_points: float, paper: PaperConfig) -> tuple[np.ndarray, np.ndarray]:
    """Replace each plane by the density clusters of its points (n, 3) that are large enough."""
    found, owner = np.full_like(labels, -1), []
    for k in range(len(equations)):
        members = np.flatnonzero(labels == k)
        clusters = point_clusters(points_m[members], paper.dbscan_eps, paper.dbscan_min_samples)
        for cluster in range(clusters.max(initial=-1) + 1):
            piece = members[clusters == cluster]
            if len(piece) >= min_points:
                found[piece] = len(owner)
                owner.append(k)
    return found, equations[np.array(owner, int)]


@one_blas_thread
def ransac_alone(depth_m: np.ndarray, config: Config | None = None) -> np.ndarray:
    """
    Label pixels by sequential RANSAC without clustering, to show the effect of clustering.

    A plane takes inliers from the whole image; there is no merging, no competition.

    Parameters
    ----------
    depth_m : (H, W) floating
        Metres, NaN invalid.
    config : Config, optional
        Its ``segmentation`` and ``ransac`` are used.

    Returns
    -------
    (H, W) int32
        Plane of each pixel, -1 none.

    """
    config = config or Config()
    image = DisparityImage(*zero_filled(np.ascontiguousarray(to_disparity(depth_m))))
    grid = build_cell_grid(image)
    noise = estimate_noise(grid, metric_noise_floor(config))
    frame = Frame(image, grid, noise, config.segmentation.min_plane_share * depth_m.size, config,
                  np.random.default_rng(config.ransac.seed))
    planes = add_planes(frame, no_planes(grid), config.segmentation.max_planes).coefficients
    return np.where(image.valid, _first_plane(image.values, planes, noise,
                                              config.ransac.inlier_threshold), -1)


def _first_plane(disparity: np.ndarray, planes: np.ndarray, noise: Noise,
                 threshold: float) -> np.ndarray:
    """Return the first plane of each pixel that is within the threshold, else -1."""
    x, y = image_coordinates(disparity.shape)
    variance = noise.mean_sigma**2 + noise.pixel_sigma**2 + noise.variance_floor(disparity)
    labels = np.full(disparity.shape, -1, np.int32)
    for k, (a, b, c) in enumerate(planes):
        error = (disparity - (a * x + b * y[:, None] + c)) ** 2
        labels[(labels < 0) & (error < threshold**2 * variance)] = k
    return labels
