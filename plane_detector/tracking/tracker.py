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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from plane_detector.config import TrackingConfig
from plane_detector.tracking.camera_motion import estimate_motion
from plane_detector.tracking.matching import (
    Overlap,
    best_pairs,
    compare,
    labels_of_found,
    likeness,
    measure_overlap,
    pixels_by_label,
    thinned,
)
from plane_detector.types import NO_PLANES, Planes, PlaneSegmentation

# The overlap is measured on about this many rows.
_ROWS = 120
_MIN_SCORE = 0.05
# Weight of a plane that was missed in the last image, relative to one that was seen in it.
_MISSED = 0.3
# Weight of a plane seen only once, which may be a fragment of an older one.
_YOUTH = 0.9
_MOTION_MIN_OVERLAP = 0.3
_MOTION_MAX_TURN_RAD = np.radians(30.0)
# chosen: a plane is merged into the one with more than half of its pixels, if both are one plane
# within three standard deviations, as for other decisions on coefficients.
_MERGED_SHARE, _MOST_DEVIATIONS = 0.5, 3.0


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
    planes: Planes  # their coefficients in the camera frame of that image


NONE_KNOWN = KnownPlanes((), NO_PLANES)


class PlaneTracker:
    """
    Assigns labels to planes; must be called with every image in order.

    Examples
    --------
    >>> normal, centroid_m = np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 2.0])
    >>> from plane_detector.types import Plane
    >>> wall = Plane(normal, 2.0, centroid_m, 12, 0.0, 1.0, np.eye(4), 1.0)
    >>> one_wall = PlaneSegmentation(Planes.of([wall]), np.zeros((3, 4), np.int32), 0.0)
    >>> tracker = PlaneTracker()
    >>> [tracker.update(one_wall, TrackingConfig()).planes.labels.tolist() for _ in range(2)]
    [[1], [1]]

    """

    def __init__(self) -> None:
        self._known = NONE_KNOWN
        self._shape: tuple[int, int] | None = None

    def update(self, found: PlaneSegmentation, config: TrackingConfig) -> PlaneSegmentation:
        """
        Return the planes of the next image with their labels, above 0 and unique.

        Their unit may change from image to image; an image of another size resets the tracker.
        Without ``config.enabled`` the planes are returned unchanged, and the tracker is reset.
        """
        if not config.enabled:
            self.reset()
            return found
        if found.labels.shape != self._shape:
            self.reset()
            self._shape = found.labels.shape
        self._known = update_tracks(self._known, found, config)
        return replace(found, planes=self._known.planes.picked(slice(len(found.planes))))

    def reset(self) -> None:
        """Discard all known planes."""
        self._known = NONE_KNOWN


def update_tracks(known: KnownPlanes, found: PlaneSegmentation, config: TrackingConfig
                  ) -> KnownPlanes:
    """Return what is known after an image; the planes of the image come first."""
    image, after = thinned(found.labels, _ROWS), found.planes
    pixels = pixels_by_label(image, len(after))
    overlap = measure_overlap([track.pixels for track in known.tracks], image, len(after))
    moved = _moved_along(known, after, pixels, overlap)
    missed = np.array([track.missed for track in known.tracks])
    deviation2, nearness = compare(moved, after, 1 + missed)
    match = _match(known.tracks, likeness(nearness, overlap, deviation2))
    labels, gone = labels_of_found(known.tracks, match, len(pixels), config.keep_frames)
    tracks = [Track(label, where, _streak(known.tracks, match.get(k)))
              for k, (label, where) in enumerate(zip(labels, pixels, strict=True))]
    tracks += [Track(one.label, one.pixels, one.streak, one.missed + 1)
               for one in map(known.tracks.__getitem__, gone)]
    after = replace(after, labels=np.array(labels, np.int64),
                    merged=_merged_labels(known.tracks, match, overlap, deviation2))
    return KnownPlanes(tuple(tracks), after.followed_by(moved.picked(gone)) if gone else after)


def _streak(tracks: Sequence[Track], index: int | None) -> int:
    """Return the number of consecutive images with a plane, by its track before this image."""
    return 1 if index is None or tracks[index].missed else tracks[index].streak + 1


def _moved_along(known: KnownPlanes, after: Planes, pixels: Sequence[np.ndarray],
                 overlap: Overlap) -> Planes:
    """Move the known planes with the motion of those that are reliably found in both images."""
    if not known.tracks:
        return known.planes
    old, new = np.nonzero(_is_sure(known, after, overlap.of_union))
    weights = overlap.of_union[old, new] * np.sqrt([len(pixels[index]) for index in new])
    return estimate_motion(known.planes, after, (old, new), weights).move(known.planes)


def _is_sure(known: KnownPlanes, after: Planes, share: np.ndarray) -> np.ndarray:
    """Return the pairs (T, N) bool whose pixels and normals leave no doubt."""
    if not len(after):
        return np.zeros(share.shape, bool)
    cosine = known.planes.normals @ after.normals.T
    was_seen = np.array([track.missed == 0 for track in known.tracks])
    return ((share > _MOTION_MIN_OVERLAP) & (share == share.max(axis=0)) & was_seen[:, None]
            & (cosine > np.cos(_MOTION_MAX_TURN_RAD)))


def _match(tracks: Sequence[Track], score: np.ndarray) -> dict[int, int]:
    """Return the track of each found plane by scores (T, N); unmatched planes are left out."""
    if not score.size:
        return {}
    missed = np.array([track.missed for track in tracks])
    score = np.where(score < _MIN_SCORE, 0, score)
    trust = (1 - _YOUTH / np.array([track.streak for track in tracks])) * _MISSED ** (missed > 0)
    score *= trust[:, None]
    rows, columns = best_pairs(score)
    return {column: row for row, column, value in zip(
        rows.tolist(), columns.tolist(), score[rows, columns].tolist(), strict=True) if value > 0}


def _merged_labels(tracks: Sequence[Track], match: Mapping[int, int], overlap: Overlap,
                   deviation2: np.ndarray) -> np.ndarray:
    """
    Return, for each plane of an image, the label that was merged into it since the last image.

    A label that has disappeared was merged into a plane that was found in the last image too, now
    covers most of its pixels, and is coplanar with it. 0: none; the largest plane if there are
    several.
    """
    count = deviation2.shape[1]
    merged, most = np.zeros(count, np.int64), np.zeros(count)
    lost = {t for t, track in enumerate(tracks) if not track.missed} - set(match.values())
    for old in lost if count else ():
        new = int(overlap.of_known[old].argmax())
        share, size = overlap.of_known[old, new], len(tracks[old].pixels)
        if (share > _MERGED_SHARE and share * size > most[new]
                and new in match and not tracks[match[new]].missed
                and deviation2[old, new] <= _MOST_DEVIATIONS**2):
            merged[new], most[new] = tracks[old].label, share * size
    return merged
