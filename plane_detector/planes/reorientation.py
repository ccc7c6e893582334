# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Regions of a network's depth laid onto planes of better orientation; agreeing pieces joined."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plane_detector.directions.line_segments import LineSegments
from plane_detector.directions.vanishing import SceneDirections
from plane_detector.geometry.projection import pixel_rays
from plane_detector.planes.line_evidence import collect_evidence
from plane_detector.planes.measurement import ray_plane_jacobian
from plane_detector.planes.orientation import orient_planes
from plane_detector.segmentation.cells.pixel_regions import PixelRegions
from plane_detector.types import CameraIntrinsics, Plane

STEP_PX = 3
"""Medians need not look at every row and column."""
# Cosine between ray and normal below which a pixel cannot be on the plane, as it is seen edge-on.
MIN_COSINE = 0.02
MIN_SAMPLES = 10
MIN_POSSIBLE_SHARE = 0.5
# Pieces of one plane: normals and distances agree, and they touch.
# tuned: python -m plane_detector.evaluation.benchmark orientation, flat from 0.1 to 0.15.
SAME_NORMAL_DEG, SAME_OFFSET_SHARE, BORDER_REACH_PX = 5.0, 0.1, 5


def reorient(regions: PixelRegions, planes: tuple[Plane, ...], segments: LineSegments,
             directions: SceneDirections, intrinsics: CameraIntrinsics) -> PixelRegions:
    """
    Turn regions to their most likely orientation, and join those that are then one plane.

    Parameters
    ----------
    regions : PixelRegions
        Of 1/z in one unit, with true angles; labels index into ``planes``.
    planes : tuple of Plane
        Measured in these regions, at least one.
    segments : LineSegments
        Of the image.
    directions : SceneDirections
        With gravity.
    intrinsics : CameraIntrinsics

    Returns
    -------
    PixelRegions
        One region per plane; those joined to another have no pixels.

    """
    axes = np.vstack([directions.down_camera[None], *(pair.axes for pair in directions.pairs[:1])])
    evidence = collect_evidence(segments, axes, regions.labels, len(planes))
    found = orient_planes(planes, directions, evidence)
    normals = np.stack([plane.normal for plane in planes])
    offsets = np.array([plane.offset_m for plane in planes])
    refitted = _offsets(regions, found.normals, intrinsics)
    changed = found.is_changed & np.isfinite(refitted)
    normals[changed], offsets[changed] = found.normals[changed], refitted[changed]
    group = _groups(regions.labels, normals, offsets)
    labels = np.where(regions.labels >= 0, group[regions.labels], -1).astype(np.int32)
    joined = replace(regions, labels=labels)
    again = _offsets(joined, normals, intrinsics)
    grown = np.isfinite(again) & (np.bincount(group, minlength=len(group)) > 1)
    offsets[grown] = again[grown]
    coefficients = np.linalg.solve(ray_plane_jacobian(intrinsics), -(normals / offsets[:, None]).T)
    return replace(joined, coefficients=coefficients.T)


def _offsets(regions: PixelRegions, normals: np.ndarray,
             intrinsics: CameraIntrinsics) -> np.ndarray:
    """Return the median distance (K,) that the pixels give planes of known normals, or NaN."""
    thinned = (slice(None, None, STEP_PX),) * 2
    labels, disparity = regions.labels[thinned], regions.disparity[thinned]
    ray_x, ray_y = (ray[::STEP_PX] for ray in pixel_rays(intrinsics))
    row, column = np.nonzero((labels >= 0) & (disparity > 0))
    label = labels[row, column]
    n = normals[label]
    cosine = -(n[:, 0] * ray_x[column] + n[:, 1] * ray_y[row] + n[:, 2])
    offset = np.where(cosine > MIN_COSINE, cosine / disparity[row, column], np.nan)
    order = np.argsort(label, kind='stable')
    pieces = np.split(offset[order], np.searchsorted(label[order], np.arange(1, len(normals))))
    return np.array([_median(piece) for piece in pieces])


def _median(offsets: np.ndarray) -> float:
    possible = offsets[np.isfinite(offsets)]
    if len(possible) < max(MIN_SAMPLES, MIN_POSSIBLE_SHARE * len(offsets)):
        return np.nan
    return float(np.median(possible))


def _groups(labels: np.ndarray, normals: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Return for each plane the first one that it is a piece of, (K,) int."""
    group = np.arange(len(normals))
    agree = normals @ normals.T > np.cos(np.radians(SAME_NORMAL_DEG))
    agree &= np.abs(np.log(offsets[:, None] / offsets)) < SAME_OFFSET_SHARE
    for a, b in np.argwhere(np.triu(agree & _touching(labels, len(normals)), 1)):
        first, second = sorted((group[a], group[b]))
        group[group == second] = first
    return group


def _touching(labels: np.ndarray, count: int) -> np.ndarray:
    """Return which regions (count, count) come within the reach of each other."""
    touching = np.zeros((count, count), bool)
    reach = BORDER_REACH_PX
    for a, b in ((labels[::2, :-reach], labels[::2, reach:]),
                 (labels[:-reach, ::2], labels[reach:, ::2])):
        border = (a != b) & (a >= 0) & (b >= 0)
        touching[a[border], b[border]] = touching[b[border], a[border]] = True
    return touching
