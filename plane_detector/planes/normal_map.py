# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Rotation of planes by the normals that a network gives in addition to depth.

1. Each region has two normals: that of its fit to 1/z, and the median of the normal map in it.
2. The noise of each is estimated from the image, by the scatter of the cells' planes and of the
   pixels' normals about them.
3. The two are averaged with these variances. The distance, then the only unknown, is fitted again
   to 1/z.

A bias common to a whole region does not show in either scatter; only a lower bound accounts for
it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plane_detector.geometry.projection import pixel_rays
from plane_detector.geometry.rigid_transform import unit_vectors
from plane_detector.planes.measurement import ray_plane_jacobian
from plane_detector.planes.region_samples import MIN_COSINE
from plane_detector.segmentation.cells.grid import fit_planes
from plane_detector.segmentation.cells.model import PixelRegions, count_labels
from plane_detector.types import CameraIntrinsics, Prediction

STEP_PX = 3
"""Every third row and column is enough for medians."""
# derived: median length of a vector of two normal variables with standard deviation 1.
RAYLEIGH_MEDIAN = 1.1774
# The best published normals have a mean error of 10 degrees, part of which is common to a
# plane; neither source is assumed more accurate than this.
MIN_SPREAD_RAD = np.radians(2.0)
# At a larger angle the two normals belong to different surfaces, or the map uses other axes.
MOST_APART_DEG = 45.0
MIN_SAMPLES = 20


def reoriented_by_normals(regions: PixelRegions, prediction: Prediction,
                      intrinsics: CameraIntrinsics) -> PixelRegions:
    """
    Rotate regions toward the normals of a network, weighted by the noise of both.

    Parameters
    ----------
    regions : PixelRegions
        Of 1/z in one unit, with true angles.
    prediction : Prediction
        Of the same image, with normals.
    intrinsics : CameraIntrinsics

    Returns
    -------
    PixelRegions
        With new coefficients and ``rotated_rad``; a region without enough normals, or whose
        normals belong to another surface, keeps its own.

    """
    normals_camera = prediction.normals_camera[::STEP_PX, ::STEP_PX]
    jacobian = ray_plane_jacobian(intrinsics)
    coefficients = regions.coefficients.copy()
    rotated_rad = np.zeros(len(coefficients))
    spreads = _cell_spreads(regions, jacobian)
    disparity, labels = (image[::STEP_PX, ::STEP_PX]
                         for image in (regions.disparity, regions.labels))
    labels = np.where(np.isfinite(normals_camera).all(axis=-1), labels, -1)
    ray_x, ray_y = (ray[::STEP_PX] for ray in pixel_rays(intrinsics))
    for k, own in enumerate(unit_vectors(-coefficients @ jacobian.T)):
        row, column = np.nonzero(labels == k)
        if len(row) < MIN_SAMPLES or not np.isfinite(spreads[k]):
            continue
        normal = _average(own, spreads[k], normals_camera[row, column].astype(float))
        rays = np.stack([ray_x[column], ray_y[row], np.ones(len(row))], axis=1)
        cosine = -rays @ normal
        if np.median(cosine) < MIN_COSINE:  # seen edge-on
            continue
        # By least squares, 1/z is cosine / offset.
        inverse_offset = float((cosine * disparity[row, column]).sum() / (cosine**2).sum())
        if inverse_offset > 0:
            coefficients[k] = np.linalg.solve(jacobian, -normal * inverse_offset)
            rotated_rad[k] = np.arccos(min(own @ normal, 1.0))
    return replace(regions, coefficients=coefficients, rotated_rad=rotated_rad)


def _average(own: np.ndarray, own_spread_rad: float, sample: np.ndarray) -> np.ndarray:
    """Return the mean of a plane's normal and of a sample (n, 3), weighted by their scatter."""
    mapped = unit_vectors(np.median(sample, axis=0))
    if own @ mapped < np.cos(np.radians(MOST_APART_DEG)):
        return own
    weight = [1 / (MIN_SPREAD_RAD**2 + spread**2) for spread in (
        own_spread_rad, _spread_rad(sample, mapped))]
    return unit_vectors(weight[0] * own + weight[1] * mapped)


def _cell_spreads(regions: PixelRegions, jacobian: np.ndarray) -> np.ndarray:
    """Return the scatter (K,) of the cells' planes in each region about its own plane."""
    grid, count = regions.grid, len(regions.coefficients)
    pixels = count_labels(grid, regions.labels, count)
    whole = (pixels == grid.moments[:, :1]) & grid.usable[:, None]
    # Not the slopes of the grid: the network's normals are included in them.
    normals = unit_vectors(-fit_planes(grid.moments) @ jacobian.T)
    own = unit_vectors(-regions.coefficients @ jacobian.T)
    return np.array([_spread_rad(normals[whole[:, k]], own[k]) for k in range(count)])


def _spread_rad(normals: np.ndarray, about: np.ndarray) -> float:
    """Return the standard deviation of normals (n, 3) about one, per axis; NaN for none."""
    if not len(normals):
        return np.nan
    return float(np.median(np.arccos(np.clip(normals @ about, -1, 1))) / RAYLEIGH_MEDIAN)

