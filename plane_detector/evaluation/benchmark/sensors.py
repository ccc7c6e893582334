# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Errors of large planes by their size in the image, of real and of simulated sensors.

The residual of a plane in disparity is split by blurs into bands: up to 2 px, 2 to 8, 8 to 24, and
coarser. White noise is in the first band only; an error that is equal in all is neither white nor
one smooth field. The bend is the part that a quadric through the residual explains.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import cv2
import numpy as np

from plane_detector.evaluation.benchmark.report import add_shared, emit, table
from plane_detector.evaluation.benchmark.samples import noisy_depth, room
from plane_detector.evaluation.datasets import labelled_frames
from plane_detector.evaluation.scenes.sensors import SENSORS

MIN_PIXELS = 8000
"""Of a plane without its border; smaller ones have no coarse part to speak of."""
BLURS_PX = (2.0, 8.0, 24.0)
BORDER_PX = 3
_OUTLIER_DEVIATIONS, _LEAST_LIMIT = 3.5, 1e-4


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_shared(parser, '--rooms', '--data', rooms=8)


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    found: dict[str, list[np.ndarray]] = {}
    for frame in labelled_frames(options.data):
        found.setdefault(frame.set_name, []).extend(errors(frame.labels, frame.depth_m))
    for name in SENSORS:
        for seed in range(options.rooms):
            depth_m = noisy_depth(room(seed), name, seed)
            found.setdefault(name, []).extend(errors(room(seed).labels, depth_m))
    rows = [[name, len(planes), *(f'{value:.2f}' for value in np.median(planes, axis=0))]
            for name, planes in found.items()]
    emit('### Residuals of large planes (1/km of disparity; medians over the planes)',
         table(('set or sensor', 'planes', 'depth (m)', 'all', 'to 2 px', '2 to 8', '8 to 24',
                'coarser', 'bend'), rows))


def errors(labels: np.ndarray, depth_m: np.ndarray) -> Iterator[np.ndarray]:
    """Yield depth, total residual, its bands and its bend of each large plane, (7,)."""
    kernel = np.ones((2 * BORDER_PX + 1,) * 2)
    for k in range(labels.max() + 1):
        inside = cv2.erode(((labels == k) & np.isfinite(depth_m)).astype(np.uint8), kernel) > 0
        if np.count_nonzero(inside) < MIN_PIXELS:
            continue
        v, u = np.nonzero(inside)
        x, y = (u - u.mean()) / 600, (v - v.mean()) / 600
        residual, kept = _residual(np.stack([x, y, np.ones(len(x))], 1), 1e3 / depth_m[v, u])
        quadric = np.stack([x * x, x * y, y * y, x, y, np.ones(len(x))], 1)[kept]
        bend = quadric @ np.linalg.lstsq(quadric, residual[kept], rcond=None)[0]
        near = np.zeros(labels.shape, bool)
        near[v[kept], u[kept]] = True
        left = np.zeros(labels.shape, np.float32)
        left[v[kept], u[kept]] = residual[kept]
        bands = []
        for blur_px in BLURS_PX:
            weight = cv2.GaussianBlur(near.astype(np.float32), (0, 0), blur_px)
            blurred = cv2.GaussianBlur(left, (0, 0), blur_px) / np.maximum(weight, 1e-6) * near
            bands.append((left - blurred)[near].std())
            left = blurred
        yield np.array([np.median(depth_m[near]), residual[kept].std(), *bands, left[near].std(),
                        bend.std()])


def _residual(design: np.ndarray, disparity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the residuals of a plane (N,), and which are no outliers."""
    kept = np.ones(len(disparity), bool)
    for _ in range(10):
        plane = np.linalg.lstsq(design[kept], disparity[kept], rcond=None)[0]
        residual = disparity - design @ plane
        deviation = 1.4826 * np.median(np.abs(residual[kept]))
        kept = np.abs(residual) < max(_OUTLIER_DEVIATIONS * deviation, 1e3 * _LEAST_LIMIT)
    return residual, kept
