# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Merging of planes of the map that turn out to be one surface."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from plane_detector.mapping.association import reach_of
from plane_detector.mapping.cells import MOST_CELLS_IN_ALL, Cells, are_near, resampled
from plane_detector.mapping.heights import heights_of, squared_misfits
from plane_detector.mapping.map_plane import MapPlane, as_planes, frames_of
from plane_detector.mapping.registration import GATE

# chosen: one surface for a robot; chi-squared, or images that show both planes, keep steps of 2
# cm.
_MOST_DISTANCE_M = 0.03
_MIN_COSINE = np.cos(np.radians(10.0))
_CONTACT_POINTS = 64
_ONE = np.zeros(1, int)


def merge_touched(planes: Sequence[MapPlane], touched: np.ndarray, up: np.ndarray
                  ) -> tuple[tuple[MapPlane, ...], dict[int, int]]:
    """
    Merge planes that an image has changed, by their labels (K,), with others of the same surface.

    Return all planes, and for each label that disappeared the plane that it is part of now.
    """
    known, gone = {plane.label: plane for plane in planes}, {}
    frames, labels = frames_of(planes), np.array([plane.label for plane in planes], int)
    found = as_planes(planes)
    normals, offsets, centroids = found.normals, found.offsets_m, found.centroids_m
    own = np.flatnonzero(np.isin(labels, touched))
    own = own[np.argsort(labels[own])]
    away_m = np.maximum(abs(normals[own] @ centroids.T + offsets[own, None]),
                        abs(centroids[own] @ normals.T + offsets))
    close = (normals[own] @ normals.T > _MIN_COSINE) & (away_m < 2 * _MOST_DISTANCE_M)
    close[np.arange(len(own)), own] = False
    touched_k, others_k = np.nonzero(close)
    pairs = np.stack([own[touched_k], others_k])
    # Most pairs differ; the rest are compared one by one, because each merge changes the next.
    larger, smaller = np.take_along_axis(pairs, np.argsort(-found.counts[pairs], axis=0), axis=0)
    heights, covariances, _ = heights_of(frames.selected(larger), found, smaller)
    alike = squared_misfits(frames.selected(larger), heights, covariances) < GATE
    for label, other in labels[pairs.T[alike]].tolist():
        if label not in known or other not in known:
            continue
        larger, smaller = sorted((known[label], known[other]),
                                 key=lambda plane: -plane.cells.count)
        if not _are_one(larger, smaller, up):
            continue
        left = MOST_CELLS_IN_ALL - sum(plane.cells.hits.size for plane in known.values())
        cells = _joined_cells(larger, smaller, left + smaller.cells.hits.size)
        if cells is None:
            continue
        known[larger.label] = _joined(larger, smaller, cells)
        del known[smaller.label]
        gone[smaller.label] = larger.label
        for plane in known.values():
            if smaller.label in plane.apart:
                known[plane.label] = replace(plane, apart=plane.apart - {smaller.label}
                                             | {larger.label})
    # A chain of merges ends at the last one.
    return tuple(known.values()), {old: _last(gone, old) for old in gone}


def _last(gone: dict[int, int], label: int) -> int:
    while label in gone:
        label = gone[label]
    return label


def _are_one(larger: MapPlane, smaller: MapPlane, up: np.ndarray) -> bool:
    if smaller.label in larger.apart or larger.label in smaller.apart:
        return False
    frame = frames_of([larger])
    heights, covariances, _ = heights_of(frame, as_planes([smaller]), _ONE)
    if squared_misfits(frame, heights, covariances)[0] >= GATE or not smaller.cells.count:
        return False
    flat_m = smaller.cells.middles_m()
    step = math.ceil(len(flat_m) / _CONTACT_POINTS)
    flat_m = larger.flat(smaller.points(flat_m[::step]))
    misfit = heights[0] - larger.coefficients
    distance_m = abs(np.column_stack([flat_m, np.ones(len(flat_m))]) @ misfit).mean()
    return (distance_m < _MOST_DISTANCE_M
            and are_near(flat_m, larger.cells, min(reach_of(larger, up),
                                                   reach_of(smaller, up))) > 0)


def _joined(larger: MapPlane, smaller: MapPlane, cells: Cells) -> MapPlane:
    """Return the larger plane with these cells, and with the information of both."""
    heights, covariances, _ = heights_of(frames_of([larger]), as_planes([smaller]), _ONE)
    information = np.linalg.inv([larger.covariance, covariances[0]])
    joint = np.linalg.inv(information.sum(axis=0))
    coefficients = joint @ (information[0] @ larger.coefficients + information[1] @ heights[0])
    return replace(larger, coefficients=coefficients, covariance=joint,
                   cells=cells, views=larger.views + smaller.views,
                   first_seen_s=min(larger.first_seen_s, smaller.first_seen_s),
                   last_seen_s=max(larger.last_seen_s, smaller.last_seen_s),
                   first_image=min(larger.first_image, smaller.first_image),
                   votes=larger.votes + smaller.votes, apart=larger.apart | smaller.apart)


def _joined_cells(larger: MapPlane, smaller: MapPlane, most: int) -> Cells | None:
    """Return the cells of both; None if that would add more than ``most`` cells."""
    (left, top), (rows, columns) = smaller.cells.low, smaller.cells.hits.shape
    corners = np.array([[u, v] for u in (left, left + columns) for v in (top, top + rows)])
    flat_m = larger.flat(smaller.points(smaller.cells.size_m * corners))
    cells = larger.cells.grown(flat_m.min(axis=0), flat_m.max(axis=0), most)
    if cells is None:
        return None
    # From u, v of the larger plane to those of the smaller one, both in cells.
    a, b, c = larger.coefficients
    along = np.array([larger.axes[0] + a * larger.axes[2], larger.axes[1] + b * larger.axes[2]])
    shift = larger.origin_m + c * larger.axes[2] - smaller.origin_m
    to_smaller = np.column_stack([smaller.axes[:2] @ along.T,
                                  smaller.axes[:2] @ shift / cells.size_m])
    hits, looks = resampled(smaller.cells, cells.low, cells.hits.shape, to_smaller)
    is_better = hits > cells.hits
    return Cells(cells.low, np.where(is_better, hits, cells.hits),
                 np.where(is_better, looks, cells.looks), cells.size_m)
