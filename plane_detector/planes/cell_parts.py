# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Connected cells on planes of one normal, joined unless the depth jumps between them."""

from __future__ import annotations

import cv2
import numpy as np

from plane_detector.compilation import kernel

# Cosine between ray and normal below which a plane is seen edge-on.
MIN_COSINE = 0.02
# The depth jumps between two cells where its logarithm changes by more than the plane's does.
# derived: a wall tilted by 40 degrees changes it by half of that.
JUMP = 0.02
# Hypotheses of one axis have the same normal but for rounding.
SAME_COSINE = 0.9999


@kernel('float64(float64[::1], float64[::1])')
def dot(a, b):
    """Return the product of two vectors (3,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def join_slices(labels: np.ndarray, shape: tuple[int, int], rays: np.ndarray,
                log_disparity: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the region (R, C) of each cell, -1 none, and a hypothesis (K,) of each region."""
    parts, first = _components(labels)
    jumps, borders = _jumps(parts, first, rays.reshape(*shape, 3),
                            log_disparity.reshape(shape), normals)
    group = np.arange(len(first))
    for a, b in np.argwhere((borders > 1) & (jumps <= JUMP * borders)):
        group[group == group[b]] = group[a]
    return np.where(parts >= 0, np.append(group, -1)[parts], -1).astype(np.int32), first


def _components(labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return connected cells (R, C) of one label, and the label (K,) of each component."""
    parts, first = np.full(labels.shape, -1, np.int32), []
    for k in np.unique(labels[labels >= 0]):
        count, found = cv2.connectedComponents((labels == k).astype(np.uint8), connectivity=4)
        parts[found > 0] = found[found > 0] + len(first) - 1
        first += [int(k)] * (count - 1)
    return parts, np.array(first, np.int64)


@kernel('Tuple((float64[:, ::1], float64[:, ::1]))(int32[:, ::1], int64[::1], '
        'float64[:, :, ::1], float64[:, ::1], float64[:, ::1])')
def _jumps(parts, first, rays, log_disparity, normals):
    """Return how much depth jumps between parts (K, K) of one normal, summed, and the borders."""
    jumps, borders = np.zeros((len(first), len(first))), np.zeros((len(first), len(first)))
    rows, columns = parts.shape
    for r in range(rows):
        for c in range(columns):
            for k in range(2):
                s, t = (r, c + 1) if k else (r + 1, c)
                if s >= rows or t >= columns:
                    continue
                a, b = parts[r, c], parts[s, t]
                if a < 0 or b < 0 or a == b:
                    continue
                normal = normals[first[a]]
                if dot(normal, normals[first[b]]) < SAME_COSINE:
                    continue
                here = max(-dot(normal, rays[r, c]), MIN_COSINE)
                there = max(-dot(normal, rays[s, t]), MIN_COSINE)
                jump = abs(log_disparity[r, c] - log_disparity[s, t] - np.log(here / there))
                a, b = min(a, b), max(a, b)
                jumps[a, b] += jump
                borders[a, b] += 1
    return jumps, borders
