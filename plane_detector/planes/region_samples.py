# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Samples of the pixels of each region, to compare their depth with planes of given normals."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.geometry.projection import pixel_rays
from plane_detector.geometry.robust import SIGMA_PER_MEDIAN, median
from plane_detector.segmentation.cells.model import PixelRegions
from plane_detector.types import CameraIntrinsics, Planes

# chosen: 30 in a region of a hundredth of the image, enough for means and spreads.
SAMPLES = 3000
# chosen: a spread needs fewer samples than the distance of a region of the same size.
SPREAD_STEP = 2
# Cosine between ray and normal below which a plane is seen edge-on and cannot contain the pixel.
MIN_COSINE = 0.02
MIN_SAMPLES = 10
MIN_POSSIBLE_SHARE = 0.5


@dataclass(frozen=True)
class RegionSamples:
    """Pixels of regions, sorted by region."""

    rays: np.ndarray  # (N, 3) float64: (x, y, 1) in the camera frame
    disparity: np.ndarray  # (N,) float64: 1/z, above 0
    region: np.ndarray  # (N,) int64: ascending
    # (N,) float64: cosine between ray and normal of the region's own plane, times the length of
    # the ray
    own_cosine: np.ndarray
    image_shares: np.ndarray  # (K,) float64: share of the image that each region covers

    @property
    def count(self) -> int:
        """Number of regions."""
        return len(self.image_shares)

    @property
    def middles(self) -> np.ndarray:
        """Mean rays (K, 3) of the regions, times their number of samples."""
        return np.stack([np.bincount(self.region, self.rays[:, axis], self.count)
                         for axis in range(3)], axis=1)

    def depth_change(self, normals: np.ndarray) -> np.ndarray:
        """
        Return the change of depth (K, C) if the planes had other normals (K, C, 3).

        It is the standard deviation of the log ratio of depths, which is independent of the
        distance. The reference is the plane fitted to the depth.
        """
        return _depth_change(self.rays, self.region, self.own_cosine,
                             np.ascontiguousarray(normals))

    def distances_to_planes(self, normals: np.ndarray, offsets: np.ndarray) -> np.ndarray:
        """
        Return the distance of regions from planes (K, J), as root mean square log ratio of depths.

        The planes have normals (J, 3) and offsets (J,); infinite if the offset is not finite.
        """
        found = _distances(self.rays, self.disparity, self.region,
                           np.ascontiguousarray(normals), offsets, self.count)
        return np.where(np.isfinite(offsets), found, np.inf)

    def offsets(self, normals: np.ndarray) -> np.ndarray:
        """
        Return the distance (K,) of planes with normals (K, 3); NaN if unknown.

        The noise is nearly constant in 1/z, which is cosine / distance, so least squares is used
        there.
        """
        return _offsets(self.rays, self.disparity, self.region, np.ascontiguousarray(normals))

    @cached_property
    def roughness(self) -> np.ndarray:
        """
        Return the deviation of the depth of each region (K,) from a plane, as a share of its
        depth.

        It is the standard deviation of normally distributed errors with their median: pixels of
        another surface at the border of a region do not affect it.
        """
        ratio = self.own_cosine / self.disparity  # of plane and depth, times the offset
        bounds = np.searchsorted(self.region, np.arange(self.count + 1))
        found = np.zeros(self.count)
        for k, (start, end) in enumerate(itertools.pairwise(bounds)):
            if end > start:
                offset = median(ratio[start:end])
                found[k] = SIGMA_PER_MEDIAN * median(np.abs(ratio[start:end] / offset - 1))
        return found

    def joined(self, group: np.ndarray) -> RegionSamples:
        """Return the samples after merging regions: region k becomes ``group[k]``."""
        region = group[self.region]
        order = np.argsort(region, kind='stable')
        shares = np.bincount(group, self.image_shares, self.count)
        return RegionSamples(self.rays[order], self.disparity[order], region[order],
                             self.own_cosine[order], shares)


def sample_regions(regions: PixelRegions, planes: Planes,
                   intrinsics: CameraIntrinsics) -> RegionSamples:
    """Sample pixels of regions of 1/z, which belong to planes, on a grid over the image."""
    step = max(1, int(np.sqrt(regions.labels.size / SAMPLES)))
    thinned = (slice(None, None, step),) * 2
    labels, disparity = (np.ascontiguousarray(image[thinned])
                         for image in (regions.labels, regions.disparity))
    ray_x, ray_y = (ray[::step].astype(float) for ray in pixel_rays(intrinsics))
    found = _sampled(labels, disparity, (ray_x, ray_y), np.ascontiguousarray(planes.normals))
    return RegionSamples(*found[:4], found[4] / labels.size)


@kernel('Tuple((float64[:, ::1], float64[::1], int64[::1], float64[::1], int64[::1]))('
        'int32[:, ::1], float32[:, ::1], UniTuple(float64[::1], 2), float64[:, ::1])',
        is_short=True, subject='network')
def _sampled(labels, disparity, rays, normals):
    """Return the fields of samples, sorted by region, and their numbers (K,)."""
    (ray_x, ray_y), counts = rays, np.zeros(len(normals), np.int64)
    for v in range(labels.shape[0]):
        for u in range(labels.shape[1]):
            if labels[v, u] >= 0 and disparity[v, u] > 0:
                counts[labels[v, u]] += 1
    places, total = np.empty_like(counts), 0
    for k in range(len(counts)):
        places[k], total = total, total + counts[k]
    seen, inverse = np.ones((total, 3)), np.empty(total)
    region, cosine = np.empty(total, np.int64), np.empty(total)
    for v in range(labels.shape[0]):
        for u in range(labels.shape[1]):
            k = labels[v, u]
            if k >= 0 and disparity[v, u] > 0:
                i, n = places[k], normals[k]
                seen[i, 0], seen[i, 1] = ray_x[u], ray_y[v]
                inverse[i], region[i] = disparity[v, u], k
                cosine[i] = -(n[0] * ray_x[u] + n[1] * ray_y[v] + n[2])
                places[k] += 1
    return seen, inverse, region, cosine, counts


@kernel('float64[::1](float64[:, ::1], float64[::1], int64[::1], float64[:, ::1])',
        is_short=True, subject='network')
def _offsets(rays, disparity, region, normals):
    sums, found = np.zeros((len(normals), 4)), np.full(len(normals), np.nan)
    for i in range(len(rays)):
        k = region[i]
        cosine = -(normals[k, 0] * rays[i, 0] + normals[k, 1] * rays[i, 1]
                   + normals[k, 2] * rays[i, 2])
        sums[k, 3] += 1
        if cosine > MIN_COSINE:
            sums[k, 0] += cosine * cosine
            sums[k, 1] += cosine * disparity[i]
            sums[k, 2] += 1
    for k in range(len(normals)):
        if sums[k, 2] >= max(MIN_SAMPLES, MIN_POSSIBLE_SHARE * sums[k, 3]):
            found[k] = sums[k, 0] / sums[k, 1]
    return found


@kernel('float64[:, ::1](float64[:, ::1], int64[::1], float64[::1], float64[:, :, ::1])',
        is_short=True, subject='network')
def _depth_change(rays, region, own_cosine, normals):
    count, hypotheses = normals.shape[:2]
    sums, squares = np.zeros((count, hypotheses)), np.zeros((count, hypotheses))
    pixels = np.zeros(count)
    for i in range(0, len(rays), SPREAD_STEP):
        k = region[i]
        pixels[k] += 1
        for c in range(hypotheses):
            n = normals[k, c]
            cosine = -(n[0] * rays[i, 0] + n[1] * rays[i, 1] + n[2] * rays[i, 2])
            change = np.log(max(cosine, MIN_COSINE) / max(own_cosine[i], MIN_COSINE))
            sums[k, c] += change
            squares[k, c] += change * change
    for k in range(count):
        for c in range(hypotheses):
            mean = sums[k, c] / max(pixels[k], 1.0)
            variance = squares[k, c] / max(pixels[k], 1.0) - mean * mean
            squares[k, c] = np.sqrt(max(variance, 0.0))
    return squares


@kernel('float64[:, ::1](float64[:, ::1], float64[::1], int64[::1], float64[:, ::1], '
        'float64[::1], int64)', is_short=True, subject='network')
def _distances(rays, disparity, region, normals, offsets, count):
    squares, pixels = np.zeros((count, len(normals))), np.zeros(count)
    for i in range(0, len(rays), SPREAD_STEP):
        k = region[i]
        pixels[k] += 1
        for j in range(len(normals)):
            n = normals[j]
            cosine = -(n[0] * rays[i, 0] + n[1] * rays[i, 1] + n[2] * rays[i, 2])
            squares[k, j] += np.log(offsets[j] * disparity[i] / max(cosine, MIN_COSINE)) ** 2
    for k in range(count):
        for j in range(len(normals)):
            squares[k, j] = np.sqrt(squares[k, j] / max(pixels[k], 1.0))
    return squares
