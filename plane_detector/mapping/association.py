# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Association of the planes of an image with the planes of the map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from plane_detector.mapping.cells import View, are_near, shared_cells
from plane_detector.mapping.heights import (
    PlaneFrames,
    heights_of,
    squared_misfits,
)
from plane_detector.mapping.map_plane import MapPlane, new_axes
from plane_detector.mapping.registration import GATE
from plane_detector.types import PlaneClass, Planes

# Planes whose normals differ by more are never compared: heights over the other would be steep.
SAME_SIDE = np.cos(np.radians(30.0))
# How far a plane continues unobserved: across gaps and furniture; an upright one across a doorway.
# chosen: the width of a leg of a table with its shadow, of a door with its frame.
REACH_M, UPRIGHT_REACH_M = 0.25, 1.2
# chosen: the floor and the ceiling of a hall.
LEVEL_REACH_M = 20.0
# chosen: a plane within 20 degrees of upright is upright.
_UPRIGHT = np.sin(np.radians(20.0))
# One in this many points of a detected plane must be within reach of the plane of the map.
_MIN_NEAR = 0.02


@dataclass(frozen=True)
class Pairs:
    """M pairs of a plane of the map and a plane of the image."""

    old: np.ndarray  # (M,) int, index of the plane in view
    new: np.ndarray  # (M,) int
    squared: np.ndarray  # (M,) chi-squared of their difference
    shared: np.ndarray  # (M,) share of the cells in view, of the plane of the map or of the image
    overlap: np.ndarray  # (M,) intersection over union of these cells

    def __len__(self) -> int:
        return len(self.old)

    def selected(self, index: np.ndarray) -> Pairs:
        """Return some pairs."""
        return Pairs(self.old[index], self.new[index], self.squared[index], self.shared[index],
                     self.overlap[index])


def visible(planes: Sequence[MapPlane], frames: PlaneFrames, view: View
            ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return planes in view that face the camera, and their cells in the planes of the image.

    Parameters
    ----------
    planes : sequence of MapPlane
    frames : PlaneFrames
        Of them.
    view : View
        With K detected planes.

    Returns
    -------
    index : (M,) int
    counts : (M, K + 1) int
        Cells in the pixels of each detected plane; the last column counts all cells in view.

    """
    camera_m = view.camera_from_map.inverse().translation_m
    faces = ((camera_m - frames.origins_m) * frames.axes[:, 2]).sum(axis=1) > 0
    lows = np.array([plane.cells.low for plane in planes]).reshape(-1, 2)
    steps = view.steps(frames, lows, planes[0].cells.size_m if len(planes) else 1.0)
    shapes = np.array([plane.cells.hits.shape for plane in planes]).reshape(-1, 2)
    index, counts = [], [np.zeros((0, view.count + 1), np.int64)]
    for k in np.flatnonzero(faces & view.may_show(steps, shapes)).tolist():
        shared = shared_cells(view, steps[k], planes[k].cells)
        if shared[-1]:
            index.append(k)
            counts.append(shared[None])
    return np.array(index, int), np.concatenate(counts)


def compare(frames: PlaneFrames, found: Planes, counts: np.ndarray, sizes: np.ndarray,
            error: np.ndarray, camera_m: np.ndarray) -> Pairs:
    """
    Return all pairs on the same side, with the chi-squared of their difference.

    Parameters
    ----------
    frames : PlaneFrames
        Planes of the map, M.
    found : Planes
        In the frame of the map, K.
    counts : (M, K + 1) int
        Of :func:`visible`.
    sizes : (K,) float
        Cells that each detected plane would cover.
    error : (6, 6) float64
        Covariance of the pose, about the camera.
    camera_m : (3,) float64

    """
    old, new = np.nonzero(frames.axes[:, 2] @ found.normals.T > SAME_SIDE)
    selected = frames.selected(old)
    heights, covariances, _ = heights_of(selected, found, new, error, camera_m)
    both, in_view = counts[old, new], counts[old, -1]
    smaller = np.minimum(in_view, sizes[new])
    return Pairs(old, new, squared_misfits(selected, heights, covariances),
                 both / np.maximum(smaller, 1), both / np.maximum(in_view + sizes[new] - both, 1))


def fitting(pairs: Pairs, planes: Sequence[MapPlane], points_m: Sequence[np.ndarray],
            up: np.ndarray) -> Pairs:
    """Return the pairs within the gate that overlap or are within reach."""
    pairs = pairs.selected(pairs.squared < GATE)
    joined = pairs.shared > 0
    for k in np.flatnonzero(~joined):
        plane = planes[pairs.old[k]]
        reach_m = reach_of(plane, up)
        joined[k] = are_near(plane.flat(points_m[pairs.new[k]]), plane.cells,
                             reach_m) > _MIN_NEAR
    return pairs.selected(joined)


def reach_of(plane: MapPlane, up: np.ndarray) -> float:
    """Return how far a plane continues unobserved, in metres."""
    if plane.plane_class in (PlaneClass.FLOOR, PlaneClass.CEILING):
        return LEVEL_REACH_M
    return UPRIGHT_REACH_M if abs(plane.axes[2] @ up) < _UPRIGHT else REACH_M


def apart_in_image(found: Planes) -> tuple[np.ndarray, np.ndarray]:
    """Return which pairs of planes (K, K) bool differ, and which face the same way."""
    same_side = found.normals @ found.normals.T > SAME_SIDE
    first, second = np.nonzero(same_side)
    feet = -found.offsets_m[:, None] * found.normals
    own = PlaneFrames(feet, new_axes(found.normals, np.eye(3)[2]), np.zeros((len(found), 3)),
                      np.zeros((len(found), 3, 3)))
    heights, covariances, _ = heights_of(own, found, np.arange(len(found)))
    own = replace(own, coefficients=heights, covariances=covariances).selected(first)
    heights, covariances, _ = heights_of(own, found, second)
    apart = ~same_side
    apart[first, second] = squared_misfits(own, heights, covariances) >= GATE
    return apart | apart.T, same_side


def assign(pairs: Pairs, apart: np.ndarray, count: int) -> np.ndarray:
    """
    Return the plane of the map for each detected plane, (K,) int, -1 for none.

    The pairs with the most overlap come first, and among equal ones those that fit best. Detected
    planes that the image shows separately never get the same plane.
    """
    taken = np.full(count, -1)
    score = pairs.overlap * np.exp(-pairs.squared / GATE) - 1e-3 * pairs.squared
    for k in np.argsort(-score, kind='stable').tolist():
        old, new = pairs.old[k], pairs.new[k]
        if taken[new] < 0 and not (apart[new] & (taken == old)).any():
            taken[new] = old
    return taken
