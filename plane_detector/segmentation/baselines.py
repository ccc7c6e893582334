# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The method of "Improved Plane Detection in 3D Reconstruction from 2D Images" (J. Quan).

Planes are peeled off the point cloud one by one with pyRANSAC-3D and one metric threshold, then
DBSCAN on each plane's points takes the artefacts away. It is the baseline that we compare with,
so pyransac3d is an optional extra and only imported here.
"""

from __future__ import annotations

import random

import numpy as np
from sklearn.cluster import DBSCAN

from plane_detector.config import Config, PaperConfig
from plane_detector.geometry.projection import depth_to_points
from plane_detector.types import CameraIntrinsics


def paper_labels(depth_m: np.ndarray, intrinsics: CameraIntrinsics, config: Config,
                 rng: np.random.Generator, cluster: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """
    Segment with the paper's method.

    Parameters
    ----------
    depth_m : (H, W) floating
    intrinsics : CameraIntrinsics
    config : Config
        Its ``segmentation`` and ``paper`` are used.
    rng : numpy.random.Generator
        Seeds pyransac3d.
    cluster : bool
        False leaves DBSCAN out: planes of RANSAC alone.

    Returns
    -------
    labels : (H, W) int32
        Index into the planes, -1 none.
    planes : (K, 3) float64
        1/z = a x + b y + c; x, y in pixels from the picture's centre over its width.

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
        thinned, equations = _cluster(thinned, thinned_m, equations, min_points, config.paper)
    labels = _to_all_pixels(thinned, points_m, equations, stride, config.paper)
    return labels, _to_picture(equations, intrinsics)


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
            equation, inliers = Plane().fit(points_m[left], config.paper.distance_threshold,
                                            maxIteration=config.paper.max_iterations)
            if len(inliers) < min_points:
                break
            labels[left[inliers]] = len(equations)
            equations.append(np.asarray(equation, float))
    finally:
        random.setstate(state)
    return labels, np.array(equations).reshape(-1, 4)


def _cluster(labels: np.ndarray, points_m: np.ndarray, equations: np.ndarray, min_points: float,
             paper: PaperConfig) -> tuple[np.ndarray, np.ndarray]:
    """Replace each plane by the density clusters of its points that are large enough."""
    out, kept = np.full(labels.shape, -1, np.int32), []
    for k, equation in enumerate(equations):
        members = labels == k
        found = DBSCAN(eps=paper.dbscan_eps, min_samples=paper.dbscan_min_samples)
        clusters = found.fit_predict(points_m[members])
        renumbered = np.full(clusters.max(initial=-1) + 2, -1, np.int32)
        for cluster in np.unique(clusters[clusters >= 0]):
            if (clusters == cluster).sum() >= min_points:
                renumbered[cluster] = len(kept)
                kept.append(equation)
        out[members] = renumbered[clusters]
    return out, np.array(kept).reshape(-1, 4)


def _to_all_pixels(thinned: np.ndarray, points_m: np.ndarray, equations: np.ndarray, stride: int,
                   paper: PaperConfig) -> np.ndarray:
    """Give each pixel near its thinned point's plane that point's label."""
    height, width = points_m.shape[:2]
    labels = thinned.repeat(stride, axis=0).repeat(stride, axis=1)[:height, :width]
    for k, equation in enumerate(equations):
        members = labels == k
        distance_m = np.abs(points_m[members] @ equation[:3] + equation[3])
        labels[members] = np.where(distance_m <= paper.distance_threshold, k, -1)
    return labels


def _to_picture(equations: np.ndarray, intrinsics: CameraIntrinsics) -> np.ndarray:
    """Turn n . p + d = 0 into 1/z = a x + b y + c."""
    ray_plane = -equations[:, :3] / np.where(equations[:, 3:] == 0, 1e-9, equations[:, 3:])
    a = ray_plane[:, 0] * intrinsics.width / intrinsics.fx
    b = ray_plane[:, 1] * intrinsics.width / intrinsics.fy
    c = (ray_plane[:, 2] + ray_plane[:, 0] * ((intrinsics.width - 1) / 2 - intrinsics.cx)
         / intrinsics.fx + ray_plane[:, 1] * ((intrinsics.height - 1) / 2 - intrinsics.cy)
         / intrinsics.fy)
    return np.stack([a, b, c], axis=1)
