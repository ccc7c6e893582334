# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tracking of spheres, cylinders and cones: a shape keeps its label from image to image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from plane_detector.tracking.matching import (
    labels_of_found,
    matched,
    measure_overlap,
    sorted_pixels,
    split_by,
    thinned,
)
from plane_detector.types import Shape

# Shapes are small and move far relative to their size, so a small overlap suffices, or a motion by
# less than their own size.
_MIN_SCORE = 0.2
_ROWS = 240
# A shape whose size differs by more than this share is a different shape.
_MAX_SIZE_CHANGE = 0.5


@dataclass(frozen=True)
class ShapeTrack:
    """A known shape, as last seen."""

    label: int  # above 0
    shape: Shape
    pixels: np.ndarray  # (M,) int, indices in the subsampled image
    missed: int = 0  # images since it was last seen


def update_shape_tracks(tracks: Sequence[ShapeTrack], shapes: Sequence[Shape], labels: np.ndarray,
                        keep_frames: int) -> tuple[tuple[ShapeTrack, ...], tuple[int, ...]]:
    """
    Match the shapes of an image with the known ones; return the new tracks, and the labels.

    Parameters
    ----------
    tracks : sequence of ShapeTrack
        Known shapes.
    shapes : sequence of Shape
        Of the next image.
    labels : (H, W) int32
        Index into the shapes, -1 none.
    keep_frames : int
        A shape that is not found keeps its label for this many images.

    """
    labels = thinned(labels, _ROWS)
    pixels, sizes = sorted_pixels(labels, len(shapes))
    known = np.array([(track.label, track.missed) for track in tracks], np.int64).reshape(-1, 2).T
    names, gone = labels_of_found(*known, _match(tracks, shapes, labels, sizes), keep_frames)
    names = names.tolist()
    seen = [ShapeTrack(*one)
            for one in zip(names, shapes, split_by(pixels, sizes), strict=True)]
    missing = [replace(tracks[k], missed=tracks[k].missed + 1) for k in gone]
    return (*seen, *missing), tuple(names)


def _match(tracks: Sequence[ShapeTrack], shapes: Sequence[Shape],
           labels: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Return the track of each shape (N,), from the labels (M,) and their sizes (N,); -1 none."""
    if not tracks or not shapes:
        return np.full(len(shapes), -1)
    overlap = measure_overlap(
        np.concatenate([track.pixels for track in tracks]),
        np.array([len(track.pixels) for track in tracks]), labels, sizes).of_union
    score = np.array([[max(overlap[t, k], _nearness(track.shape, shape))
                       if _are_alike(track.shape, shape) else 0.0
                       for k, shape in enumerate(shapes)] for t, track in enumerate(tracks)])
    return matched(score, _MIN_SCORE)


def _are_alike(before: Shape, after: Shape) -> bool:
    """Return whether two shapes have the same type and about the same size."""
    sizes = [(before.radius_m, after.radius_m), (before.half_angle_rad, after.half_angle_rad)]
    return before.type == after.type and all(
        abs(a - b) <= _MAX_SIZE_CHANGE * max(a, b) for a, b in sizes)


def _nearness(before: Shape, after: Shape) -> float:
    """Return 1 at the same position, less with the distance relative to the size."""
    size_m = max(before.radius_m, before.length_m / 2, 1e-6)
    return float(np.exp(-np.sum((before.position_m - after.position_m) ** 2) / size_m**2))
