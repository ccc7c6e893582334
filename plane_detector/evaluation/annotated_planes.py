# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Reference planes of a real image, from annotated instances and the depth of a sensor.

In each annotated instance the plane close to most of the sensor's points is removed repeatedly,
until few points remain. No code of the detector is used. An instance that is visible in several
pieces, such as a wall behind furniture, is one plane; instances are never merged.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from plane_detector.evaluation.sensor_comparison import TOLERANCE_M, TOLERANCE_SHARE, best_plane
from plane_detector.geometry.projection import depth_to_points
from plane_detector.types import CameraIntrinsics

MIN_PIXELS = 1500
# assumed, not tuned, because no annotated image was available: a smaller share of an instance is
# more likely a strip of a curved surface that is within the tolerance by chance.
MIN_INSTANCE_SHARE = 0.2
MAX_PLANES = 6


def annotated_planes(segments: np.ndarray, depth_m: np.ndarray, intrinsics: CameraIntrinsics,
                     rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """
    Find the planes of each annotated instance.

    Parameters
    ----------
    segments : (H, W) int
        Instance of each pixel, 0 for none.
    depth_m : (H, W) floating
        Of the sensor, NaN where not measured.
    intrinsics : CameraIntrinsics
    rng : numpy.random.Generator
        For the hypotheses.

    Returns
    -------
    labels : (H, W) int32
        Index into the planes, or -1.
    planes : (K, 4) float64
        Unit normal pointing to the camera, and offset in metres.

    """
    points_m = depth_to_points(depth_m, intrinsics)
    seen = np.isfinite(points_m[..., 2])
    labels = np.full(segments.shape, -1, np.int32)
    planes: list[np.ndarray] = []
    for instance in range(1, int(segments.max(initial=0)) + 1):
        rows, columns = np.nonzero(seen & (segments == instance))
        for plane, near in _peeled(points_m[rows, columns].astype(np.float64), rng):
            labels[rows[near], columns[near]] = len(planes)
            planes.append(plane)
    return labels, np.array(planes).reshape(-1, 4)


def _peeled(points_m: np.ndarray, rng: np.random.Generator,
            ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield planes (4,) of points (N, 3), largest first, and the indices of the points on each."""
    left = np.arange(len(points_m))
    least = max(MIN_PIXELS, MIN_INSTANCE_SHARE * len(left))
    for _ in range(MAX_PLANES):
        if len(left) < least:
            return
        plane = best_plane(points_m[left], rng)
        near = np.abs(points_m[left] @ plane[:3] + plane[3]) <= np.maximum(
            TOLERANCE_M, TOLERANCE_SHARE * points_m[left, 2])
        if np.count_nonzero(near) < least:
            return
        yield plane, left[near]
        left = left[~near]
