# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Predicted planes judged by the depth that a sensor measured.

The truth about a predicted plane is the best plane through the sensor's points under its pixels:
the one that most of them are near, then fitted to these by least squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.evaluation.metrics import overlap
from plane_detector.geometry.projection import depth_to_points
from plane_detector.types import CameraIntrinsics

# A pixel is on a plane within this, or within this share of its depth where that is more.
TOLERANCE_M = 0.03
TOLERANCE_SHARE = 0.015
LARGE_PLANE_SHARE = 0.02
# A predicted plane that holds this share of a sensor's plane is one of its pieces.
PIECE_SHARE = 0.1
MIN_SENSOR_PIXELS = 100
_MAX_SAMPLES = 1500
_HYPOTHESES = 300
_REFITS = 3


@dataclass(frozen=True)
class JudgedPlane:
    """
    One predicted plane.

    Attributes
    ----------
    pixels : int
        Of the plane that the sensor measured.
    purity : float
        Share of them near the best plane through the sensor's points there.
    normal_error_deg, offset_error_m : float
        Of the predicted plane against that one.

    """

    pixels: int
    purity: float
    normal_error_deg: float
    offset_error_m: float


@dataclass(frozen=True)
class Coverage:
    """
    How the sensor's large planes were found.

    Attributes
    ----------
    planes : int
        How many the sensor has over LARGE_PLANE_SHARE of the picture.
    share : float
        Of their pixels, those that a predicted plane with IoU > 0.5 covers; NaN without any.
    pieces : float
        Mean number of predicted planes that each of them is cut into.

    """

    planes: int
    share: float
    pieces: float


def judge_planes(labels: np.ndarray, planes: np.ndarray, sensor_depth_m: np.ndarray,
                 intrinsics: CameraIntrinsics, rng: np.random.Generator) -> list[JudgedPlane]:
    """
    Judge each predicted plane that the sensor measured at all.

    Parameters
    ----------
    labels : (H, W) int
        Index into ``planes``, -1 none.
    planes : (K, 4) float64
        Unit normal and offset.
    sensor_depth_m : (H, W) floating
        NaN where not measured.
    intrinsics : CameraIntrinsics
    rng : numpy.random.Generator
        Draws the hypotheses of the best plane.

    """
    points_m = depth_to_points(sensor_depth_m, intrinsics)
    seen = np.isfinite(points_m[..., 2])
    judged = []
    for k, plane in enumerate(planes):
        there_m = points_m[seen & (labels == k)].astype(float)
        if len(there_m) < MIN_SENSOR_PIXELS:
            continue
        best = best_plane(there_m, rng)
        cosine = np.clip(plane[:3] @ best[:3], -1, 1)
        judged.append(JudgedPlane(len(there_m), float(_near(there_m, best).mean()),
                                  float(np.degrees(np.arccos(cosine))),
                                  float(abs(plane[3] - best[3]))))
    return judged


def best_plane(points_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the plane (4,) that most of the points (n, 3) are near, towards the camera."""
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
        near = points_m[_near(points_m, plane)]
        plane = _least_squares(near if len(near) >= 3 else points_m)
    return plane if plane[3] >= 0 else -plane


def _least_squares(points_m: np.ndarray) -> np.ndarray:
    centroid = points_m.mean(0)
    centred = points_m - centroid
    normal = np.linalg.eigh(centred.T @ centred)[1][:, 0]
    return np.append(normal, -normal @ centroid)


def _near(points_m: np.ndarray, plane: np.ndarray) -> np.ndarray:
    return np.abs(points_m @ plane[:3] + plane[3]) <= _tolerance(points_m)


def _tolerance(points_m: np.ndarray) -> np.ndarray:
    return np.maximum(TOLERANCE_M, TOLERANCE_SHARE * points_m[:, 2])


def judge_coverage(sensor_labels: np.ndarray, labels: np.ndarray,
                   seen: np.ndarray) -> Coverage:
    """
    Say how the large planes of the sensor's depth were found.

    Parameters
    ----------
    sensor_labels, labels : (H, W) int
        Planes of the sensor's depth and predicted planes, -1 none.
    seen : (H, W) bool
        Where the sensor measured; only these pixels count.

    """
    shared = overlap(sensor_labels, labels, seen)
    pixels = shared.counts[:-1].sum(1)
    large = pixels > LARGE_PLANE_SHARE * seen.size
    if not large.any():
        return Coverage(0, float('nan'), float('nan'))
    both = shared.counts[:-1, :-1]
    covered = (both * (shared.iou > 0.5)).sum(1)[large].sum()
    pieces = (both > PIECE_SHARE * pixels[:, None]).sum(1)[large]
    return Coverage(int(large.sum()), float(covered / pixels[large].sum()), float(pieces.mean()))
