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

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from plane_detector.config import TrackingConfig
from plane_detector.tracking.assignment import best_pairs
from plane_detector.tracking.camera_motion import estimate_motion
from plane_detector.tracking.matching import (
    Overlap,
    PlaneArrays,
    free_labels,
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
    """A known plane."""

    label: int  # above 0
    pixels: np.ndarray  # (M,) int, indices in the subsampled image in which it was last seen
    streak: int = 1  # consecutive images in which it was found, up to the last one
    missed: int = 0  # images since it was last found


@dataclass(frozen=True)
class KnownPlanes:
    """The known planes after an image."""

    tracks: tuple[Track, ...]  # of the planes of the image, in its order, then missing ones
    planes: PlaneArrays  # their coefficients in the camera frame of that image


NONE_KNOWN = KnownPlanes((), PlaneArrays.of(()))


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
        self._known = NONE_KNOWN
        self._shape: tuple[int, int] | None = None

    def update(self, found: PlaneSegmentation, config: TrackingConfig
               ) -> tuple[PlaneSegmentation, tuple[int, ...]]:
        """
        Return the planes of the next image, and the label of each, above 0 and unique.

        Their unit may change from image to image; an image of another size resets the tracker.
        Coefficients are smoothed if ``config.smoothing`` is above 0. Without ``config.enabled``
        there are no labels, and the tracker is reset.
        """
        if not config.enabled:
            self.reset()
            return found, ()
        if found.labels.shape != self._shape:
            self.reset()
            self._shape = found.labels.shape
        self._known, planes = update_tracks(self._known, found, config)
        if planes is not found.planes:
            found = replace(found, planes=planes)
        return found, tuple(track.label for track in self._known.tracks[:len(planes)])

    def reset(self) -> None:
        """Discard all known planes."""
        self._known = NONE_KNOWN


def update_tracks(known: KnownPlanes, found: PlaneSegmentation, config: TrackingConfig
                  ) -> tuple[KnownPlanes, tuple[Plane, ...]]:
    """Return what is known after an image, and its planes, smoothed if that is requested."""
    pixels, after = _pixels_of_planes(found), PlaneArrays.of(found.planes)
    overlap = measure_overlap([track.pixels for track in known.tracks], pixels)
    moved = _moved_along(known, after, pixels, overlap)
    match = _match(known.tracks, moved, after, overlap)
    matched = set(match.values())
    gone = [index for index, track in enumerate(known.tracks)
            if index not in matched and track.missed < config.keep_frames]
    tracks = (*_seen_tracks(known.tracks, match, gone, pixels),
              *(replace(known.tracks[index], missed=known.tracks[index].missed + 1)
                for index in gone))
    planes = found.planes
    if config.smoothing > 0:
        planes = _smoothed(planes, known, after, match, config.smoothing)
        after = PlaneArrays.of(planes)
    return KnownPlanes(tracks, after.followed_by(moved.picked(gone))), planes


def _seen_tracks(tracks: Sequence[Track], match: Mapping[int, int], gone: Sequence[int],
                 pixels: Sequence[np.ndarray]) -> Iterator[Track]:
    """Yield the track of each found plane, new ones with the smallest free labels."""
    new_labels = free_labels({tracks[index].label for index in (*gone, *match.values())})
    for index, where in enumerate(pixels):
        if index in match:
            old = tracks[match[index]]
            yield Track(old.label, where, 1 if old.missed else old.streak + 1)
        else:
            yield Track(next(new_labels), where)


def _pixels_of_planes(found: PlaneSegmentation) -> list[np.ndarray]:
    """Return the indices of each plane's pixels in the subsampled image."""
    step = max(1, min(found.labels.shape) // _ROWS)
    labels = found.labels[::step, ::step].ravel()
    if len(found.planes) < np.iinfo(np.int16).max:
        labels = labels.astype(np.int16)  # sorted by radix, in a sixth of the time
    order = np.argsort(labels, kind='stable')
    ends = np.searchsorted(labels[order], np.arange(-1, len(found.planes)), side='right')
    return [order[begin:end] for begin, end in zip(ends, ends[1:], strict=False)]


def _moved_along(known: KnownPlanes, after: PlaneArrays, pixels: Sequence[np.ndarray],
                 overlap: Overlap) -> PlaneArrays:
    """Move the known planes with the motion of those that are reliably found in both images."""
    if not known.tracks:
        return known.planes
    old, new = np.nonzero(_is_sure(known, after, overlap.of_union))
    weights = overlap.of_union[old, new] * np.sqrt([len(pixels[index]) for index in new])
    return estimate_motion(known.planes.picked(old), after.picked(new), weights).move(known.planes)


def _is_sure(known: KnownPlanes, after: PlaneArrays, share: np.ndarray) -> np.ndarray:
    """Return the pairs (T, N) bool whose pixels and normals leave no doubt."""
    if not len(after):
        return np.zeros(share.shape, bool)
    cosine = known.planes.normals @ after.normals.T
    was_seen = np.array([track.missed == 0 for track in known.tracks])
    return ((share > _MOTION_MIN_OVERLAP) & (share == share.max(axis=0)) & was_seen[:, None]
            & (cosine > np.cos(_MOTION_MAX_TURN_RAD)))


def _match(tracks: Sequence[Track], before: PlaneArrays, after: PlaneArrays,
           overlap: Overlap) -> dict[int, int]:
    """Return the track of each found plane; unmatched planes are left out."""
    if not tracks or not len(after):
        return {}
    missed = np.array([track.missed for track in tracks])
    score = likeness(before, after, overlap, 1 + missed)
    score[score < _MIN_SCORE] = 0
    trust = (1 - _YOUTH / np.array([track.streak for track in tracks])) * _MISSED ** (missed > 0)
    score *= trust[:, None]
    rows, columns = best_pairs(score)
    return {column: row for row, column, value in zip(
        rows.tolist(), columns.tolist(), score[rows, columns].tolist(), strict=True) if value > 0}


def _smoothed(planes: Sequence[Plane], known: KnownPlanes, after: PlaneArrays,
              match: Mapping[int, int], share: float) -> tuple[Plane, ...]:
    """Return planes averaged with their past, unless the change exceeds the noise."""
    smooth = list(planes)
    for new, old in match.items():
        changed = squared_deviation(known.planes.picked([old]), after.picked([new]),
                                    1.0, _NOISE_ANGLE_DEG, _NOISE_OFFSET)
        if not known.tracks[old].missed and changed.item() <= _NOISE_DEVIATIONS ** 2:
            smooth[new] = _averaged(planes[new], known.planes.normals[old],
                                    known.planes.offsets_m[old], share)
    return tuple(smooth)


def _averaged(plane: Plane, old_normal: np.ndarray, old_offset_m: float, share: float) -> Plane:
    """Return the plane with the given share of old coefficients."""
    normal = share * old_normal + (1 - share) * plane.normal
    normal /= np.linalg.norm(normal)
    offset_m = float(share * old_offset_m + (1 - share) * plane.offset_m)
    centroid_m = plane.centroid_m - (plane.centroid_m @ normal + offset_m) * normal
    return replace(plane, normal=normal, offset_m=offset_m, centroid_m=centroid_m)
