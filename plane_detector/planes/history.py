# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
History of the planes of a stream, so that noise alone changes neither class nor confidence.

The inclination of a plane to gravity and its confidence are averages over its last images, the
inclination only while it is constant within its error. A plane that is new, or has turned, is
judged by its current image alone.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from plane_detector.types import CameraIntrinsics, PlaneClass, Planes

# chosen: a third of a second, as for the evidence of the segmentation.
MOST_IMAGES = 10
# Reduction of the limits of a class for the class that a plane had, and increase for others.
# tuned: switches of class of planes of over 1 % of the image in four real videos, one image to the
# next: 175 of 2511 alone, 57 with averages, 16 with these, 8 with twice as much.
YIELDING_DEG, YIELDING_PROBABILITY = 1.0, 0.05
# A plane has turned if it differs by more than this many standard deviations and YIELDING_DEG.
# derived: three, as for other differences of planes.
SIGMAS = 3.0


@dataclass(frozen=True)
class PlaneHistory:
    """A row for each plane of an image, in its order; none by default."""

    labels: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    images: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))  # 0: new
    confidences: np.ndarray = field(default_factory=lambda: np.empty(0))  # averages
    # Averages of normal . gravity; NaN where unknown.
    cosines: np.ndarray = field(default_factory=lambda: np.empty(0))
    classes: np.ndarray = field(default_factory=lambda: np.empty(0, np.uint8))  # the last ones
    camera: CameraIntrinsics | None = None  # of the image

    def of(self, planes: Planes, camera: CameraIntrinsics) -> PlaneHistory:
        """Return the history for the planes of the next image, by their labels."""
        known = self.labels.tolist() if camera == self.camera else []
        rows = {label: row for row, label in enumerate(known)}
        row = np.array([rows.get(label, len(self.labels)) for label in planes.labels.tolist()],
                       int)
        return PlaneHistory(planes.labels, *(np.append(column, none)[row] for column, none in (
            (self.images, 0), (self.confidences, np.nan), (self.cosines, np.nan),
            (self.classes, np.uint8(PlaneClass.UNKNOWN)))), camera)

    def mean_confidences(self, planes: Planes) -> np.ndarray:
        """Return the confidences (K,) with those of the same planes in the next image."""
        return self._mean(self.confidences, planes.confidences, self.images > 0)

    def inclined(self, planes: Planes, down: np.ndarray) -> PlaneHistory:
        """
        Return the history with the inclinations in the next image.

        There may be more planes than rows: the additional planes are new.
        """
        now, rows = planes.normals @ down, len(self.labels)
        angle, before = (np.arccos(np.clip(one, -1, 1)) for one in (now[:rows], self.cosines))
        sigmas = np.sqrt(np.einsum('kii->k', planes.covariances[:rows, :3, :3]))
        is_same = abs(angle - before) <= SIGMAS * sigmas + np.radians(YIELDING_DEG)
        classes = np.zeros(len(now), np.uint8)
        classes[:rows] = self.classes
        now[:rows] = self._mean(self.cosines, now[:rows], is_same)
        return replace(self, cosines=now, classes=classes)

    def yields_deg(self, *kinds: PlaneClass) -> np.ndarray:
        """Return by how much a limit of classes yields, for planes that had one, or not (K,)."""
        by_class = np.full(len(PlaneClass), -YIELDING_DEG)
        by_class[list(kinds)], by_class[PlaneClass.UNKNOWN] = YIELDING_DEG, 0.0
        return by_class[self.classes]

    def after(self, planes: Planes) -> PlaneHistory:
        """Return the history of an image, with the confidences and classes of its planes."""
        rows = len(planes)
        return PlaneHistory(planes.labels, np.minimum(self.images + 1, MOST_IMAGES - 1),
                            planes.confidences, self.cosines[:rows], planes.classes,
                            self.camera)

    def _mean(self, before: np.ndarray, now: np.ndarray, is_same: np.ndarray) -> np.ndarray:
        return np.where(is_same, (self.images * np.where(is_same, before, 0.0) + now)
                        / (self.images + 1), now)


NO_HISTORY = PlaneHistory()
