# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The same plane keeps its label from picture to picture, without odometry.

The planes that lie on each other in two pictures tell how the camera moved; known planes are
moved along. A known plane and a found one are the same as far as they share pixels, or lie at
the same place, and their coefficients agree within their uncertainty; the Hungarian method
assigns them one to one. Labels are taken anew only once their plane is forgotten.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
from scipy.optimize import linear_sum_assignment

from plane_detector.config import TrackingConfig
from plane_detector.plane_motion import estimate_motion
from plane_detector.types import Plane, PlaneSegmentation

# Overlap is measured on about this many rows.
_ROWS = 120
_MIN_SCORE = 0.05
# Of two known planes that a found one may be, the one of the picture before comes first.
_MISSED = 0.3
_YOUTH = 0.5
_MOTION_MIN_OVERLAP = 0.3
_MOTION_MAX_TURN_RAD = np.radians(30.0)
# Coefficients that change by more are not noise, and are not smoothed.
_NOISE_DEVIATIONS, _NOISE_ANGLE_DEG, _NOISE_OFFSET = 3.0, 0.3, 0.003


@dataclass(frozen=True)
class Track:
    """
    A plane that has been seen.

    Attributes
    ----------
    label : int
        Above 0.
    plane : Plane
        Its coefficients in the latest camera frame.
    pixels : (M,) int
        Indices into the thinned picture where it was seen last.
    streak : int
        Pictures in a row that it was found in, up to when it was found last.
    missed : int
        Pictures since it was found last.

    """

    label: int
    plane: Plane
    pixels: np.ndarray
    streak: int = 1
    missed: int = 0


class PlaneTracker:
    """
    Gives planes their labels; call it with every picture in order.

    Parameters
    ----------
    config : TrackingConfig, optional
        May be replaced between two pictures.

    """

    def __init__(self, config: TrackingConfig | None = None) -> None:
        self.config = config or TrackingConfig()
        self._tracks: tuple[Track, ...] = ()
        self._shape: tuple[int, int] | None = None

    def update(self, found: PlaneSegmentation) -> tuple[PlaneSegmentation, tuple[int, ...]]:
        """
        Take the planes of the next picture.

        Parameters
        ----------
        found : PlaneSegmentation
            In any unit, which may change from picture to picture. A picture of another size
            starts anew.

        Returns
        -------
        PlaneSegmentation
            The same planes, their coefficients smoothed when the settings say so.
        tuple of int
            Label of each plane, above 0, no label twice.

        """
        if found.labels.shape != self._shape:
            self.reset()
            self._shape = found.labels.shape
        self._tracks, seen = update_tracks(self._tracks, found, self.config)
        planes = tuple(track.plane for track in seen)
        return replace(found, planes=planes), tuple(track.label for track in seen)

    def reset(self) -> None:
        """Forget all planes."""
        self._tracks = ()


def update_tracks(tracks: tuple[Track, ...], found: PlaneSegmentation, config: TrackingConfig
                  ) -> tuple[tuple[Track, ...], tuple[Track, ...]]:
    """
    Match the planes of a picture with the known ones.

    Parameters
    ----------
    tracks : tuple of Track
        Known planes.
    found : PlaneSegmentation
        Of the next picture.
    config : TrackingConfig

    Returns
    -------
    known : tuple of Track
        What is known now: planes of this picture and those missed for a while.
    seen : tuple of Track
        The track of each plane of this picture, in its order.

    """
    pixels = _pixels_of_planes(found)
    overlap = _overlaps([track.pixels for track in tracks], pixels)
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
    """Return the indices of each plane's pixels in the thinned picture."""
    step = max(1, min(found.labels.shape) // _ROWS)
    labels = found.labels[::step, ::step].ravel()
    order = np.argsort(labels, kind='stable')
    ends = np.searchsorted(labels[order], np.arange(-1, len(found.planes)), side='right')
    return [order[begin:end] for begin, end in zip(ends, ends[1:], strict=False)]


def _overlaps(before: Sequence[np.ndarray], after: Sequence[np.ndarray]) -> np.ndarray:
    """Return intersection over union of pixels (T, N)."""
    size = 1 + max((int(pixels.max(initial=0)) for pixels in (*before, *after)), default=0)
    plane = np.zeros(size, np.intp)
    for index, pixels in enumerate(after):
        plane[pixels] = index + 1
    common = np.array([np.bincount(plane[pixels], minlength=len(after) + 1)[1:]
                       for pixels in before]).reshape(len(before), len(after))
    total = np.add.outer([len(p) for p in before], [len(p) for p in after]) - common
    return common / np.maximum(total, 1)


def _move_along(tracks: Sequence[Track], planes: Sequence[Plane], pixels: Sequence[np.ndarray],
                overlap: np.ndarray) -> list[Track]:
    """Move known planes as the camera's motion moves those that surely are in both pictures."""
    pairs = [(int(best), index) for index, best in enumerate(overlap.argmax(axis=0))
             if _is_sure(tracks[best], planes[index], overlap[best, index])] if len(tracks) else []
    motion = estimate_motion([tracks[t].plane for t, _ in pairs], [planes[p] for _, p in pairs],
                             np.array([overlap[t, p] * len(pixels[p]) for t, p in pairs]))
    return [replace(track, plane=motion.move(track.plane)) for track in tracks]


def _is_sure(track: Track, plane: Plane, overlap: float) -> bool:
    turn = np.arccos(np.clip(track.plane.normal @ plane.normal, -1, 1))
    return (track.missed == 0 and overlap > _MOTION_MIN_OVERLAP
            and turn < _MOTION_MAX_TURN_RAD)


def _match(tracks: Sequence[Track], planes: Sequence[Plane], overlap: np.ndarray,
           config: TrackingConfig) -> dict[int, int]:
    """Return which track each found plane is; planes that are none of them are left out."""
    if not tracks or not planes:
        return {}
    before, after = _stack([track.plane for track in tracks]), _stack(planes)
    missed = np.array([track.missed for track in tracks])
    place = np.maximum(overlap, _nearness(before, after))
    score = place * np.exp(-0.5 * _squared_deviation(before, after, missed, config))
    trust = (1 - _YOUTH / np.array([track.streak for track in tracks])) * _MISSED ** (missed > 0)
    score *= trust[:, None]
    rows, columns = linear_sum_assignment(score, maximize=True)
    return {int(column): int(row) for row, column in zip(rows, columns, strict=True)
            if score[row, column] >= _MIN_SCORE}


@dataclass(frozen=True)
class _Stack:
    """
    Planes as arrays.

    Attributes
    ----------
    normal, centroid_m : (N, 3) float64
    offset_m, distance_m, area_m2 : (N,) float64
        Of the plane from the camera, of the centroid from the camera, of the plane.
    normal_variance, distance_variance : (N,) float64
        Squared radians; squared shares of the distance, at the centroid.

    """

    normal: np.ndarray
    centroid_m: np.ndarray
    offset_m: np.ndarray
    distance_m: np.ndarray
    area_m2: np.ndarray
    normal_variance: np.ndarray
    distance_variance: np.ndarray


def _stack(planes: Sequence[Plane]) -> _Stack:
    centroid_m = np.stack([plane.centroid_m for plane in planes])
    distance_m = np.maximum(np.linalg.norm(centroid_m, axis=1), 1e-12)
    covariance = np.stack([plane.covariance for plane in planes])
    point = np.column_stack([centroid_m, np.ones(len(planes))])
    return _Stack(
        np.stack([plane.normal for plane in planes]), centroid_m,
        np.array([plane.offset_m for plane in planes]), distance_m,
        np.array([plane.area_m2 for plane in planes]),
        np.trace(covariance[:, :3, :3], axis1=1, axis2=2),
        np.einsum('ni,nij,nj->n', point, covariance, point) / distance_m ** 2)


def _nearness(before: _Stack, after: _Stack) -> np.ndarray:
    """Return (T, N): 1 for the same centroid, less the farther apart for the smaller's size."""
    apart_m = before.centroid_m[:, None] - after.centroid_m
    smaller_m2 = np.maximum(np.minimum.outer(before.area_m2, after.area_m2), 1e-12)
    larger_m2 = np.maximum(np.maximum.outer(before.area_m2, after.area_m2), 1e-12)
    return np.exp(-(apart_m ** 2).sum(axis=2) / smaller_m2) * np.sqrt(smaller_m2 / larger_m2)


def _squared_deviation(before: _Stack, after: _Stack, missed: np.ndarray,
                       config: TrackingConfig) -> np.ndarray:
    """Return (T, N): angle, and distance of centroid from plane, by their uncertainty."""
    turn_rad = np.arccos(np.clip(before.normal @ after.normal.T, -1, 1))
    off = (before.centroid_m @ after.normal.T + after.offset_m) / before.distance_m[:, None]
    back = (before.normal @ after.centroid_m.T + before.offset_m[:, None]) / after.distance_m
    floor = (1 + missed)[:, None]
    turn_variance = (np.radians(config.angle_tolerance) ** 2 * floor
                     + np.add.outer(before.normal_variance, after.normal_variance))
    off_variance = (config.offset_tolerance ** 2 * floor
                    + np.add.outer(before.distance_variance, after.distance_variance))
    return turn_rad ** 2 / turn_variance + (off ** 2 + back ** 2) / (2 * off_variance)


def _free_labels(taken: Collection[int]) -> Iterator[int]:
    """Yield the smallest labels that no known plane has."""
    return (label for label in count(1) if label not in taken)


def _smoothed(track: Track, plane: Plane, share: float) -> Plane:
    """Return the plane drawn towards what it was, unless it has changed beyond the noise."""
    old = track.plane
    if share == 0 or track.missed:
        return plane
    before, after = _stack([old]), _stack([plane])
    floors = TrackingConfig(angle_tolerance=_NOISE_ANGLE_DEG, offset_tolerance=_NOISE_OFFSET)
    changed = _squared_deviation(before, after, np.zeros(1), floors) > _NOISE_DEVIATIONS ** 2
    if changed.any():
        return plane
    normal = share * old.normal + (1 - share) * plane.normal
    normal /= np.linalg.norm(normal)
    offset_m = share * old.offset_m + (1 - share) * plane.offset_m
    centroid_m = plane.centroid_m - (plane.centroid_m @ normal + offset_m) * normal
    return replace(plane, normal=normal, offset_m=offset_m, centroid_m=centroid_m)
