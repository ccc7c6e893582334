# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Evaluation of planes by the measured depth of a sensor.

The reference for a plane is the best plane through the sensor's points in its pixels: the plane
close to most of them, fitted to these by least squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.geometry.projection import depth_to_points
from plane_detector.types import CameraIntrinsics

# A pixel is on a plane within this distance, or within this share of its depth if that is more.
TOLERANCE_M = 0.03
TOLERANCE_SHARE = 0.015
MIN_SENSOR_PIXELS = 100
_MAX_SAMPLES = 1500
_HYPOTHESES = 300
_REFITS = 3


@dataclass(frozen=True)
class JudgedPlane:
    """Errors of one plane against the sensor's points in its pixels."""

    index: int  # of the plane among those evaluated
    pixels: int  # pixels of the plane with sensor depth
    distance_m: float  # median distance of the sensor's points from the plane
    # share of these points close to the best plane through them; 1 if the pixels really are
    # one plane
    purity: float
    normal_error_deg: float  # errors of the plane against that best plane
    offset_error_m: float


def judge_planes(labels: np.ndarray, planes: np.ndarray, sensor_depth_m: np.ndarray,
                 intrinsics: CameraIntrinsics, rng: np.random.Generator) -> list[JudgedPlane]:
    """
    Evaluate each plane with at least MIN_SENSOR_PIXELS pixels of sensor depth.

    Parameters
    ----------
    labels : (H, W) int
        Index into ``planes``, or -1.
    planes : (K, 4) floating
        Unit normal and offset in metres.
    sensor_depth_m : (H, W) floating
        NaN where not measured.
    intrinsics : CameraIntrinsics
    rng : numpy.random.Generator
        For the hypotheses of the best plane.

    Returns
    -------
    list of JudgedPlane
        In the order of ``planes``.

    """
    points_m = depth_to_points(sensor_depth_m, intrinsics)
    seen = np.isfinite(points_m[..., 2])
    judged = []
    for k, plane in enumerate(np.asarray(planes, np.float64)):
        there_m = points_m[seen & (labels == k)].astype(np.float64)
        if len(there_m) >= MIN_SENSOR_PIXELS:
            judged.append(_judge(k, plane, there_m, rng))
    return judged


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
        near = points_m[_near(points_m, plane)]
        plane = _least_squares(near if len(near) >= 3 else points_m)
    return plane if plane[3] >= 0 else -plane


def _judge(index: int, plane: np.ndarray, points_m: np.ndarray,
           rng: np.random.Generator) -> JudgedPlane:
    best = best_plane(points_m, rng)
    cosine = np.clip(plane[:3] @ best[:3], -1, 1)
    return JudgedPlane(
        index, len(points_m),
        distance_m=float(np.median(np.abs(points_m @ plane[:3] + plane[3]))),
        purity=float(_near(points_m, best).mean()),
        normal_error_deg=float(np.degrees(np.arccos(cosine))),
        offset_error_m=float(abs(plane[3] - best[3])))


def _least_squares(points_m: np.ndarray) -> np.ndarray:
    centroid = points_m.mean(0)
    centred = points_m - centroid
    normal = np.linalg.eigh(centred.T @ centred)[1][:, 0]
    return np.append(normal, -normal @ centroid)


def _near(points_m: np.ndarray, plane: np.ndarray) -> np.ndarray:
    return np.abs(points_m @ plane[:3] + plane[3]) <= _tolerance(points_m)


def _tolerance(points_m: np.ndarray) -> np.ndarray:
    return np.maximum(TOLERANCE_M, TOLERANCE_SHARE * points_m[:, 2])
