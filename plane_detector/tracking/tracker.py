# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Tracking of planes without odometry: a plane keeps its label from image to image.

1. Estimate the motion of the camera from planes that overlap in two images, and move the known
   planes with it.
2. Score each pair of a known and a detected plane by shared pixels or position, and by how well
   their coefficients agree within their uncertainty.
3. Assign them one to one by the Hungarian method [Kuhn 1955].

A label is reused only after its plane has been dropped.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from plane_detector.config import TrackingConfig
from plane_detector.tracking.camera_motion import estimate_motion
from plane_detector.tracking.matching import (
    Overlap,
    compare,
    labels_of_found,
    matched,
    measure_overlap,
    sorted_pixels,
    split_by,
    thinned,
)
from plane_detector.types import NO_PLANES, Planes, PlaneSegmentation

# The overlap is measured on about this many rows.
_ROWS = 120
_MIN_SCORE = 0.05
# Weight of a plane that was missed in the last image, relative to one that was detected in it.
_MISSED = 0.3
# Weight of a plane that was detected only once, and may be a fragment of an older one.
_YOUTH = 0.9
_MOTION_MIN_OVERLAP = 0.3
_MOTION_MIN_COSINE = np.cos(np.radians(30.0))
# chosen: a plane is merged into the one with more than half of its pixels, if both are one plane
# within three standard deviations, as for other decisions on coefficients.
_MERGED_SHARE, _MOST_DEVIATIONS = 0.5, 3.0

# chosen: three times the deviation of one plane between two images; nearer planes are in front.
_BEFORE_SHARE = 0.1


@dataclass(frozen=True)
class KnownPlanes:
    """The T known planes after an image: those of the image, in its order, then missing ones."""

    planes: Planes  # in the camera frame of that image, with their labels
    pixels: np.ndarray  # (M,) int32, plane by plane, in the thinned image that last showed it
    sizes: np.ndarray  # (T,) int64, number of pixels of each
    streaks: np.ndarray  # (T,) int64: consecutive images in which it was found, up to the last one
    missed: np.ndarray  # (T,) int64: images since it was last found


NONE_KNOWN = KnownPlanes(NO_PLANES, np.zeros(0, np.int32), *np.zeros((3, 0), np.int64))


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
        self._known, planes = update_tracks(self._known, found, config)
        return replace(found, planes=planes)

    def reset(self) -> None:
        """Discard all known planes."""
        self._known = NONE_KNOWN


def update_tracks(known: KnownPlanes, found: PlaneSegmentation, config: TrackingConfig
                  ) -> tuple[KnownPlanes, Planes]:
    """Return the known planes after an image, and its own planes with their labels."""
    image, after = thinned(found.labels, _ROWS), found.planes
    pixels, sizes = sorted_pixels(image, len(after))
    overlap = measure_overlap(known.pixels, known.sizes, image, sizes)
    moved = _moved_along(known, after, sizes, overlap)
    deviation2, nearness = compare(moved, after, 1 + known.missed)
    # By shared pixels, of all pixels or of those still visible, or by the centroids if the camera
    # has turned so far that no pixels are shared.
    place = np.maximum((overlap.of_union + overlap.of_known) / 2, nearness)
    place = np.maximum(place, _share_of_seen(moved, after, sizes, overlap.common))
    score = place * np.exp(-0.5 * deviation2)
    trust = (1 - _YOUTH / known.streaks) * np.where(known.missed > 0, _MISSED, 1.0)
    match = matched(np.where(score < _MIN_SCORE, 0, score) * trust[:, None], 0.0)
    labels, gone = labels_of_found(moved.labels, known.missed, match, config.keep_frames)
    # The last column is for planes that were not known.
    streaks = np.append(np.where(known.missed == 0, known.streaks, 0), 0)[match] + 1
    after = replace(after, labels=labels, merged=_merged_labels(known, match, overlap, deviation2))
    if not len(gone):
        return KnownPlanes(after, pixels, sizes, streaks, np.zeros_like(sizes)), after
    parts = split_by(known.pixels, known.sizes)
    return KnownPlanes(
        after.concatenated(moved.selected(gone)),
        np.concatenate([pixels, *(parts[k] for k in gone)]),
        np.concatenate([sizes, known.sizes[gone]]), np.concatenate([streaks, known.streaks[gone]]),
        np.concatenate([np.zeros_like(sizes), known.missed[gone] + 1])), after


def _share_of_seen(known: Planes, after: Planes, sizes: np.ndarray,
                   common: np.ndarray) -> np.ndarray:
    """
    Return the shared pixels of two planes as a share of the pixels that show either, (T, N).

    Where there is no plane now, or a plane in front of the known one, the known plane may continue
    behind it: if a person leaves a tenth of a wall visible, only this tenth can be compared.
    """
    is_seen = np.where(_nearer(known, after) > _BEFORE_SHARE, 0, common)
    either = is_seen.sum(axis=1, keepdims=True) + sizes - is_seen
    return is_seen / np.maximum(either, 1)


def _nearer(known: Planes, after: Planes) -> np.ndarray:
    """Return how far planes are in front of known ones, as a share of their distance, (T, N)."""
    return (known.normals @ after.centroids_m.T + known.offsets_m[:, None]
            ) / known.distances_m[:, None]


def _moved_along(known: KnownPlanes, after: Planes, sizes: np.ndarray,
                 overlap: Overlap) -> Planes:
    """Move the known planes with the motion of planes that are reliably matched in both images."""
    share = overlap.of_union
    if not share.size:
        return known.planes
    cosines = known.planes.normals @ after.normals.T
    # A person who steps in front of a wall takes many of its pixels, and the wall takes them back
    # later; where a part of the wall is visible at its place, planes in front or behind are
    # different.
    nearer = _nearer(known.planes, after)
    is_rest = (abs(nearer) < _BEFORE_SHARE) & (cosines > _MOTION_MIN_COSINE) & (overlap.common > 0)
    is_another = (((nearer > _BEFORE_SHARE) & is_rest.any(axis=1, keepdims=True))
                  | ((nearer < -_BEFORE_SHARE) & is_rest.any(axis=0, keepdims=True)))
    # The pairs whose pixels and normals leave no doubt.
    old, new = ((share > _MOTION_MIN_OVERLAP) & (share == share.max(axis=0))
                & (known.missed == 0)[:, None] & (cosines > _MOTION_MIN_COSINE)
                & ~is_another).nonzero()
    weights = share[old, new] * np.sqrt(sizes[new])
    return estimate_motion(known.planes, after, (old, new), weights).move(known.planes)


def _merged_labels(known: KnownPlanes, match: np.ndarray, overlap: Overlap,
                   deviation2: np.ndarray) -> np.ndarray:
    """
    Return, for each plane of an image, the label merged into it since the last image.

    A label that has disappeared was merged into a plane that was also detected in the last image,
    now covers most of its pixels, and is coplanar with it. 0: none; the largest if there are
    several.
    """
    merged, most = np.zeros(len(match), np.int64), np.zeros(len(match))
    is_lost = known.missed == 0
    is_lost[match[match >= 0]] = False
    for old in is_lost.nonzero()[0] if len(match) else ():
        new = int(overlap.of_known[old].argmax())
        share, size = overlap.of_known[old, new], known.sizes[old]
        if (share > _MERGED_SHARE and share * size > most[new]
                and match[new] >= 0 and known.missed[match[new]] == 0
                and deviation2[old, new] <= _MOST_DEVIATIONS**2):
            merged[new], most[new] = known.planes.labels[old], share * size
    return merged
