# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Planes through given points, without any code of the detector, as references for its planes.

The best plane is the one close to most of the points, fitted to these by least squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.evaluation.datasets import Frame
from plane_detector.evaluation.metrics import angle_deg
from plane_detector.geometry.projection import depth_to_points
from plane_detector.pipeline import segment_planes
from plane_detector.planes.classification import lowest_level, refine_gravity
from plane_detector.types import CameraIntrinsics, Plane

# A pixel is on a plane within this distance, or within this share of its depth if that is more.
TOLERANCE_M, TOLERANCE_SHARE = 0.03, 0.015
MIN_SENSOR_PIXELS = 100
MIN_POINTS = 3
_MAX_SAMPLES, _HYPOTHESES, _REFITS = 1500, 300, 3


@dataclass(frozen=True)
class JudgedPlane:
    """Errors of one plane relative to the best plane through the sensor's points in its pixels."""

    purity: float  # share of its pixels close to the best plane; 1 if they really are one plane
    normal_error_deg: float


def judge_planes(labels: np.ndarray, planes: np.ndarray, sensor_depth_m: np.ndarray,
                 intrinsics: CameraIntrinsics, rng: np.random.Generator) -> list[JudgedPlane]:
    """
    Evaluate each plane (K, 4) with at least MIN_SENSOR_PIXELS pixels of sensor depth, in order.

    The labels (H, W) index the planes, -1 for none; the generator is for the hypotheses.
    """
    points_m = depth_to_points(sensor_depth_m, intrinsics)
    seen = np.isfinite(points_m[..., 2])
    judged = []
    for k, plane in enumerate(np.asarray(planes, np.float64)):
        there_m = points_m[seen & (labels == k)].astype(np.float64)
        if len(there_m) >= MIN_SENSOR_PIXELS:
            best = best_plane(there_m, rng)
            judged.append(JudgedPlane(float(near(there_m, best).mean()),
                                      float(angle_deg(plane[:3], best[:3]))))
    return judged


def true_floor(frame: Frame) -> Plane | None:
    """Return the floor in the sensor's depth, if any; its normal is against gravity."""
    planes = segment_planes(frame.depth_m, frame.intrinsics).planes
    down = refine_gravity(planes, np.array([0.0, 1.0, 0.0]), 40.0)
    return None if down is None else lowest_level(planes, down)


def best_plane(points_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the plane (4,) close to most of the points (n, 3), facing the camera."""
    sample = points_m[rng.integers(len(points_m), size=min(len(points_m), _MAX_SAMPLES))]
    triples = sample[rng.integers(len(sample), size=(_HYPOTHESES, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
    distance = np.abs(sample @ normals.T - (triples[:, 0] * normals).sum(1))
    support = (distance <= _tolerance(sample)[:, None]).sum(0) * (length[:, 0] > 0)
    chosen = int(np.argmax(support))
    plane = np.append(normals[chosen], -normals[chosen] @ triples[chosen, 0])
    for _ in range(_REFITS):
        on_plane_m = points_m[near(points_m, plane)]
        plane = least_squares(on_plane_m if len(on_plane_m) >= MIN_POINTS else points_m)
    return plane


def near(points_m: np.ndarray, plane: np.ndarray) -> np.ndarray:
    """Return which points (N, 3) are on a plane, within the tolerance."""
    return np.abs(points_m @ plane[:3] + plane[3]) <= _tolerance(points_m)


def _tolerance(points_m: np.ndarray) -> np.ndarray:
    return np.maximum(TOLERANCE_M, TOLERANCE_SHARE * points_m[:, 2])


def least_squares(points_m: np.ndarray) -> np.ndarray:
    """Return the plane (4,) of points (N, 3) by total least squares, facing the camera."""
    centroid_m = points_m.mean(axis=0)
    centred_m = points_m - centroid_m
    normal = np.linalg.eigh(centred_m.T @ centred_m)[1][:, 0]
    plane = np.append(normal, -normal @ centroid_m)
    return plane if plane[3] >= 0 else -plane


def fit_planes(labels: np.ndarray, depth_m: np.ndarray,
               intrinsics: CameraIntrinsics) -> np.ndarray:
    """Return the planes (K, 4) of the points of each label; NaN for fewer than MIN_POINTS."""
    points_m = depth_to_points(depth_m, intrinsics)
    seen = np.isfinite(points_m[..., 2])
    planes = np.full((int(labels.max(initial=-1)) + 1, 4), np.nan)
    for k in range(len(planes)):
        on_plane_m = points_m[seen & (labels == k)].astype(float)
        if len(on_plane_m) >= MIN_POINTS:
            planes[k] = least_squares(on_plane_m)
    return planes


def plane_depth(labels: np.ndarray, planes: np.ndarray,
                intrinsics: CameraIntrinsics) -> np.ndarray:
    """Return the depth (H, W) at which each pixel's ray meets its plane, NaN without a plane."""
    if not len(planes):
        return np.full(labels.shape, np.nan)
    x = (np.arange(intrinsics.width) - intrinsics.cx) / intrinsics.fx
    y = (np.arange(intrinsics.height)[:, None] - intrinsics.cy) / intrinsics.fy
    a, b, c, d = np.moveaxis(planes[labels], -1, 0)
    with np.errstate(divide='ignore', invalid='ignore'):
        return np.where(labels >= 0, -d / (a * x + b * y + c), np.nan)
