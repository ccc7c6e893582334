# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Planes turned by the normals that a network gives beside its depth.

1. Each region has two normals: that of its fit to 1/z, and the median of the normal map in it.
2. The noise of each is measured on the image: how far the cells' own planes, and the pixels'
   normals, stray about them.
3. The two are averaged by these variances. The distance is then one unknown, fitted anew to 1/z.

A bias that is the same all over a region is in neither spread; only the floor speaks for it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plane_detector.geometry.projection import pixel_rays
from plane_detector.planes.measurement import ray_plane_jacobian
from plane_detector.segmentation.cells.labels import count_labels
from plane_detector.segmentation.cells.pixel_regions import PixelRegions
from plane_detector.segmentation.cells.plane_fit import fit_planes
from plane_detector.types import CameraIntrinsics, Prediction

STEP_PX = 3
"""Medians need not look at every row and column."""
# derived: the median of the length of two normal deviates of standard deviation 1.
RAYLEIGH_MEDIAN = 1.1774
# The best published normals are 10 degrees off on the average, of which a part is alike all over
# a plane; no spread makes either source surer than this.
MIN_SPREAD_RAD = np.radians(2.0)
# Farther apart the two do not speak of one surface, or the map has other axes than it should.
MOST_APART_DEG = 45.0
MIN_SAMPLES = 20
# Cosine between ray and normal below which a plane is seen edge-on.
MIN_COSINE = 0.02


def turned_by_normals(regions: PixelRegions, prediction: Prediction,
                      intrinsics: CameraIntrinsics) -> PixelRegions:
    """
    Turn regions to the normals of a network, by the noise of both.

    Parameters
    ----------
    regions : PixelRegions
        Of 1/z in one unit, with true angles.
    prediction : Prediction
        Of the same image; without normals the result is unchanged.
    intrinsics : CameraIntrinsics

    Returns
    -------
    PixelRegions
        With other coefficients; a region without enough normals, or whose normals speak of
        another surface, keeps its own.

    """
    if prediction.normals_camera is None:
        return regions
    normals_camera = prediction.normals_camera[::STEP_PX, ::STEP_PX]
    jacobian = ray_plane_jacobian(intrinsics)
    coefficients = regions.coefficients.copy()
    spreads = _cell_spreads(regions, jacobian)
    disparity, labels = (image[::STEP_PX, ::STEP_PX]
                         for image in (regions.disparity, regions.labels))
    labels = np.where(np.isfinite(normals_camera).all(axis=-1), labels, -1)
    ray_x, ray_y = (ray[::STEP_PX] for ray in pixel_rays(intrinsics))
    for k, own in enumerate(_unit(-coefficients @ jacobian.T)):
        row, column = np.nonzero(labels == k)
        if len(row) < MIN_SAMPLES or not np.isfinite(spreads[k]):
            continue
        normal = _average(own, spreads[k], normals_camera[row, column].astype(float))
        rays = np.stack([ray_x[column], ray_y[row], np.ones(len(row))], axis=1)
        inverse_offset = _inverse_offset(normal, rays, disparity[row, column])
        if inverse_offset > 0:
            coefficients[k] = np.linalg.solve(jacobian, -normal * inverse_offset)
    return replace(regions, coefficients=coefficients)


def _average(own: np.ndarray, own_spread_rad: float, sample: np.ndarray) -> np.ndarray:
    """Return the mean of a plane's own normal and of a sample (n, 3), by their spreads."""
    mapped = _unit(np.median(sample, axis=0))
    if own @ mapped < np.cos(np.radians(MOST_APART_DEG)):
        return own
    weight = [1 / (MIN_SPREAD_RAD**2 + spread**2) for spread in (
        own_spread_rad, _spread_rad(sample, mapped))]
    return _unit(weight[0] * own + weight[1] * mapped)


def _cell_spreads(regions: PixelRegions, jacobian: np.ndarray) -> np.ndarray:
    """Return how far (K,) the planes of the cells within each region stray about its own."""
    grid, count = regions.grid, len(regions.coefficients)
    pixels = count_labels(grid, regions.labels, count)
    whole = (pixels == grid.moments[:, :1]) & grid.usable[:, None]
    # The slopes of the grid are not those of the depth alone: the normals are in them.
    normals = _unit(-fit_planes(grid.moments) @ jacobian.T)
    own = _unit(-regions.coefficients @ jacobian.T)
    return np.array([_spread_rad(normals[whole[:, k]], own[k]) for k in range(count)])


def _spread_rad(normals: np.ndarray, about: np.ndarray) -> float:
    """Return the standard deviation of normals (n, 3) about one, per axis; NaN for none."""
    if not len(normals):
        return np.nan
    return float(np.median(np.arccos(np.clip(normals @ about, -1, 1))) / RAYLEIGH_MEDIAN)


def _inverse_offset(normal: np.ndarray, rays: np.ndarray, disparity: np.ndarray) -> float:
    """Return the least-squares 1/offset of 1/z = -(n . r) / offset; 0 where it is seen edge-on."""
    cosine = -rays @ normal
    if np.median(cosine) < MIN_COSINE:
        return 0.0
    return float((cosine * disparity).sum() / (cosine**2).sum())


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
