# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A sample of the pixels of each region: what its depth says about planes of given normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.geometry.projection import pixel_rays
from plane_detector.segmentation.cells.pixel_regions import PixelRegions
from plane_detector.types import CameraIntrinsics, Plane

# derived: some thousand samples tell medians and spreads of regions of a hundredth of the image.
SAMPLES = 8000
# Cosine between ray and normal below which a pixel cannot be on the plane, as it is seen edge-on.
MIN_COSINE = 0.02
MIN_SAMPLES = 10
MIN_POSSIBLE_SHARE = 0.5


@dataclass(frozen=True)
class RegionSamples:
    """
    Pixels of regions, sorted by region.

    Attributes
    ----------
    rays : (N, 3) float64
        (x, y, 1) in the camera frame.
    disparity : (N,) float64
        1/z, above 0.
    region : (N,) int64
        Ascending.
    own_cosine : (N,) float64
        Between ray and the normal of the region's own plane, times the length of the ray.
    count : int
        Of regions.

    """

    rays: np.ndarray
    disparity: np.ndarray
    region: np.ndarray
    own_cosine: np.ndarray
    count: int

    def depth_change(self, normals: np.ndarray) -> np.ndarray:
        """
        Return by which factor planes of other normals (K, C, 3) would change the depth, (K, C).

        It is the standard deviation of the logarithm, so that the distance is at its best. The
        reference is the plane that was fitted to the depth.
        """
        cosine = -np.einsum('nci,ni->nc', normals[self.region], self.rays)
        change = np.log(np.maximum(cosine, MIN_COSINE)
                        / np.maximum(self.own_cosine, MIN_COSINE)[:, None])
        pixels = np.maximum(np.bincount(self.region, minlength=self.count), 1)[:, None]
        mean, square = (self._sums(values) / pixels for values in (change, change * change))
        return np.sqrt(np.maximum(square - mean**2, 0.0))

    def _sums(self, values: np.ndarray) -> np.ndarray:
        """Return the sums (K, C) of values (N, C) over each region."""
        return np.stack([np.bincount(self.region, column, self.count) for column in values.T],
                        axis=1)

    def offsets(self, normals: np.ndarray) -> np.ndarray:
        """Return the median distance (K,) of planes of given normals (K, 3); NaN where unknown."""
        cosine = -(normals[self.region] * self.rays).sum(1)
        offset = np.where(cosine > MIN_COSINE, cosine / self.disparity, np.nan)
        pieces = np.split(offset, np.searchsorted(self.region, np.arange(1, self.count)))
        return np.array([_median(piece) for piece in pieces])

    def joined(self, group: np.ndarray) -> RegionSamples:
        """Return the samples of regions that are joined: region k becomes ``group[k]``."""
        region = group[self.region]
        order = np.argsort(region, kind='stable')
        return RegionSamples(self.rays[order], self.disparity[order], region[order],
                             self.own_cosine[order], self.count)


def sample_regions(regions: PixelRegions, planes: tuple[Plane, ...],
                   intrinsics: CameraIntrinsics) -> RegionSamples:
    """
    Take pixels on a grid over the image.

    Parameters
    ----------
    regions : PixelRegions
        Of 1/z; labels index into ``planes``.
    planes : tuple of Plane
        Measured in these regions, at least one.
    intrinsics : CameraIntrinsics

    """
    step = max(1, int(np.sqrt(regions.labels.size / SAMPLES)))
    thinned = (slice(None, None, step),) * 2
    labels, disparity = regions.labels[thinned], regions.disparity[thinned]
    ray_x, ray_y = (ray[::step] for ray in pixel_rays(intrinsics))
    row, column = np.nonzero((labels >= 0) & (disparity > 0))
    order = np.argsort(labels[row, column], kind='stable')
    row, column = row[order], column[order]
    region = labels[row, column].astype(np.int64)
    rays = np.stack([ray_x[column], ray_y[row], np.ones(len(row))], axis=1)
    normals = np.stack([plane.normal for plane in planes])
    return RegionSamples(rays, disparity[row, column].astype(float), region,
                         -(normals[region] * rays).sum(1), len(planes))


def _median(offsets: np.ndarray) -> float:
    possible = offsets[np.isfinite(offsets)]
    if len(possible) < max(MIN_SAMPLES, MIN_POSSIBLE_SHARE * len(offsets)):
        return np.nan
    return float(np.median(possible))
