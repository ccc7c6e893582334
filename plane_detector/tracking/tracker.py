# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Tracking of planes without odometry: a plane keeps its label from image to image.

1. Estimate the motion of the camera from planes that overlap in two images, and move the known
   planes with it.
2. Score each pair of a known and a found plane by shared pixels or position, and by how well their
   coefficients agree within their uncertainty.
3. Assign them one to one by the Hungarian method [Kuhn 1955].

A label is reused only after its plane has been dropped.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
from scipy.optimize import linear_sum_assignment

from plane_detector.config import TrackingConfig
from plane_detector.tracking.camera_motion import estimate_motion
from plane_detector.tracking.matching import (
    Overlap,
    likeness,
    measure_overlap,
    squared_deviation,
)
from plane_detector.types import Plane, PlaneSegmentation

# The overlap is measured on about this many rows.
_ROWS = 120
_MIN_SCORE = 0.05
# Weight of a plane that was missed in the last image, relative to one that was seen in it.
_MISSED = 0.3
# Weight of a plane seen only once, which may be a fragment of an older one.
_YOUTH = 0.9
_MOTION_MIN_OVERLAP = 0.3
_MOTION_MAX_TURN_RAD = np.radians(30.0)
# Larger changes of the coefficients are not noise and are not smoothed.
_NOISE_DEVIATIONS, _NOISE_ANGLE_DEG, _NOISE_OFFSET = 3.0, 0.3, 0.003


@dataclass(frozen=True)
class Track:
    """
    A known plane.

    Attributes
    ----------
    label : int
        Above 0.
    plane : Plane
        Its coefficients in the latest camera frame.
    pixels : (M,) int
        Indices of its pixels in the subsampled image in which it was last seen.
    streak : int
        Number of consecutive images in which it was found, up to the last one.
    missed : int
        Images since it was last found.

    """

    label: int
    plane: Plane
    pixels: np.ndarray
    streak: int = 1
    missed: int = 0


class PlaneTracker:
    """
    Assigns labels to planes; must be called with every image in order.

    Examples
    --------
    >>> normal, centroid_m = np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 2.0])
    >>> wall = Plane(normal, 2.0, centroid_m, 12, 0.0, 1.0, np.eye(4), 1.0)
    >>> one_wall = PlaneSegmentation((wall,), np.zeros((3, 4), np.int32), 0.0)
    >>> tracker = PlaneTracker()
    >>> [tracker.update(one_wall, TrackingConfig())[1] for _ in range(2)]
    [(1,), (1,)]

    """

    def __init__(self) -> None:
        self._tracks: tuple[Track, ...] = ()
        self._shape: tuple[int, int] | None = None

    def update(self, found: PlaneSegmentation, config: TrackingConfig
               ) -> tuple[PlaneSegmentation, tuple[int, ...]]:
        """
        Match the planes of the next image and assign labels to them.

        Parameters
        ----------
        found : PlaneSegmentation
            In any unit, which may change from image to image. An image of another size resets
            the tracker.
        config : TrackingConfig

        Returns
        -------
        PlaneSegmentation
            The same planes, with smoothed coefficients if ``config.smoothing`` is above 0.
        tuple of int
            Label of each plane, above 0 and unique; empty, and the tracker is reset, without
            ``config.enabled``.

        """
        if not config.enabled:
            self.reset()
            return found, ()
        if found.labels.shape != self._shape:
            self.reset()
            self._shape = found.labels.shape
        self._tracks, seen = update_tracks(self._tracks, found, config)
        planes = tuple(track.plane for track in seen)
        return replace(found, planes=planes), tuple(track.label for track in seen)

    def reset(self) -> None:
        """Discard all known planes."""
        self._tracks = ()


def update_tracks(tracks: tuple[Track, ...], found: PlaneSegmentation, config: TrackingConfig
                  ) -> tuple[tuple[Track, ...], tuple[Track, ...]]:
    """
    Match the planes of an image with known planes.

    Parameters
    ----------
    tracks : tuple of Track
        Known planes.
    found : PlaneSegmentation
        Of the next image.
    config : TrackingConfig

    Returns
    -------
    known : tuple of Track
        The tracks after this image: those of its planes, and those that have been missing for a
        short time.
    seen : tuple of Track
        The track of each plane of this image, in its order.

    """
    pixels = _pixels_of_planes(found)
    overlap = measure_overlap([track.pixels for track in tracks], pixels)
    moved = _move_along(tracks, found.planes, pixels, overlap)
    match = _match(moved, found.planes, overlap, config)
    gone = [replace(track, missed=track.missed + 1) for index, track in enumerate(moved)
            if index not in match.values() and track.missed < config.keep_frames]
    kept = {track.label for track in gone} | {tracks[index].label for index in match.values()}
    new_labels = _free_labels(kept)
    seen = []
    for index, (plane, where) in enumerate(zip(found.planes, pixels, strict=True)):
        if index in match:
            old = tracks[match[index]]
            seen.append(Track(old.label, _smoothed(old, plane, config.smoothing), where,
                              1 if old.missed else old.streak + 1))
        else:
            seen.append(Track(next(new_labels), plane, where))
    return (*seen, *gone), tuple(seen)


def _pixels_of_planes(found: PlaneSegmentation) -> list[np.ndarray]:
    """Return the indices of each plane's pixels in the subsampled image."""
    step = max(1, min(found.labels.shape) // _ROWS)
    labels = found.labels[::step, ::step].ravel()
    if len(found.planes) < np.iinfo(np.int16).max:
        labels = labels.astype(np.int16)  # sorted by radix, in a sixth of the time
    order = np.argsort(labels, kind='stable')
    ends = np.searchsorted(labels[order], np.arange(-1, len(found.planes)), side='right')
    return [order[begin:end] for begin, end in zip(ends, ends[1:], strict=False)]


def _move_along(tracks: Sequence[Track], planes: Sequence[Plane], pixels: Sequence[np.ndarray],
                overlap: Overlap) -> list[Track]:
    """Move the known planes with the motion of those that are reliably found in both images."""
    if not tracks:
        return []
    old, new = np.nonzero(_is_sure(tracks, planes, overlap.of_union))
    weights = overlap.of_union[old, new] * np.sqrt([len(pixels[index]) for index in new])
    motion = estimate_motion([tracks[index].plane for index in old],
                             [planes[index] for index in new], weights)
    moved = motion.move_all([track.plane for track in tracks])
    return [replace(track, plane=plane) for track, plane in zip(tracks, moved, strict=True)]


def _is_sure(tracks: Sequence[Track], planes: Sequence[Plane], share: np.ndarray) -> np.ndarray:
    """Return the pairs (T, N) bool whose pixels and normals leave no doubt."""
    if not planes:
        return np.zeros(share.shape, bool)
    cosine = (np.stack([track.plane.normal for track in tracks])
              @ np.stack([plane.normal for plane in planes]).T)
    was_seen = np.array([track.missed == 0 for track in tracks])
    return ((share > _MOTION_MIN_OVERLAP) & (share == share.max(axis=0)) & was_seen[:, None]
            & (cosine > np.cos(_MOTION_MAX_TURN_RAD)))


def _match(tracks: Sequence[Track], planes: Sequence[Plane], overlap: Overlap,
           config: TrackingConfig) -> dict[int, int]:
    """Return the track of each found plane; unmatched planes are left out."""
    if not tracks or not planes:
        return {}
    before = [track.plane for track in tracks]
    missed = np.array([track.missed for track in tracks])
    score = likeness(before, planes, overlap, (config.angle_tolerance, config.offset_tolerance),
                     1 + missed)
    score[score < _MIN_SCORE] = 0
    trust = (1 - _YOUTH / np.array([track.streak for track in tracks])) * _MISSED ** (missed > 0)
    score *= trust[:, None]
    rows, columns = linear_sum_assignment(score, maximize=True)
    return {int(column): int(row) for row, column in zip(rows, columns, strict=True)
            if score[row, column] > 0}


def _free_labels(taken: Collection[int]) -> Iterator[int]:
    """Yield the smallest free labels."""
    return (label for label in count(1) if label not in taken)


def _smoothed(track: Track, plane: Plane, share: float) -> Plane:
    """Return the plane averaged with its past, unless the change exceeds the noise."""
    old = track.plane
    if share == 0 or track.missed:
        return plane
    changed = squared_deviation([old], [plane], _NOISE_ANGLE_DEG, _NOISE_OFFSET)
    if changed.item() > _NOISE_DEVIATIONS ** 2:
        return plane
    normal = share * old.normal + (1 - share) * plane.normal
    normal /= np.linalg.norm(normal)
    offset_m = share * old.offset_m + (1 - share) * plane.offset_m
    centroid_m = plane.centroid_m - (plane.centroid_m @ normal + offset_m) * normal
    return replace(plane, normal=normal, offset_m=offset_m, centroid_m=centroid_m)
