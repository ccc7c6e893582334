# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Memory from one image of a stream to the next.

Each image has new noise, and binary decisions that depend on it make planes blink. The planes of
the previous image, refitted to the current depth of their cells, are additional hypotheses for the
search: where the camera or an object has moved they fit badly, and others win. One plane stays one
and two planes stay two until the average evidence of about ten images exceeds its limit, or one
image is clear enough for two planes. Where the depth has changed more than elsewhere in the image,
for example where an object appears or disappears, the image alone decides. The noise is measured
anew in each image, and the planes are found with the mean of these measurements: of the fewer
images, the more of the scene has changed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.geometry.robust import median
from plane_detector.segmentation.cells.grid import CellGrid, fit_planes
from plane_detector.segmentation.cells.model import (
    MAX_DEVIATIONS,
    MEAN_D,
    MEAN_WEIGHT,
    WeightedCells,
    add_up,
)
from plane_detector.segmentation.cells.noise import Noise

# Factor on the support of a plane of the previous image.
# tuned: a video of a standing sensor, and 12 draws of .05 % noise on 8 sensor frames, of seed 100:
# pairs of images that lose a plane 14 in 147 at 1.3, 22 at 1.15, 19 at 1.5.
PREFERENCE = 1.3
# Factors by which a statistic must clear its limit: for two planes, and for curvature.
# tuned: as above; 14 at 3, 13 at 4, 18 at 2. Of curvature, on 12 draws of seed 100 of all 16
# frames and the video with two seeds: 20 in 294 at 2 and 2.8, 25 at 1.4, 36 at 1.
CLEAR, CLEARLY_CURVED = 3.0, 2.0
# Images over which evidence is averaged.
# chosen: a third of a second.
MOST_IMAGES = 10
# What is averaged of the noise; which cells have local noise, and its floors, are of the image.
MEASURED = ('mean_sigma', 'slope_sigma', 'pixel_sigma', 'bending', 'lateral_px', 'lateral_shared')
# Average evidence below which two planes become one, and above which one becomes two; 1 is clear
# of the limit. The pieces of the previous image are hypotheses, so that two return by themselves.
# tuned: 20 draws of .05 % noise on 16 sensor frames, of seeds 100 to 103, and a video of a
# standing sensor with four seeds: pairs of images that lose a plane 59 in 1216, and planes 15 in
# 236; 62 and 15 at -0.2, 0.2; 63 and 21 at -0.05, 0.15; 68 and 34 at -0.1, 0.1.
JOINS, PARTS = -0.1, 0.2
# The scene has changed where the disparity has, by this many times the median of the image.
# chosen: one normal deviate in 20 is three times their median modulus. On the data of curvature:
# 20 at 3, 23 at 4.2, 35 at 2.1, 19 without it; it is there for what comes and goes.
CHANGED = 3.0


class Decision(IntEnum):
    """Decisions made with the evidence of several images."""

    MISFIT = 0  # one plane fits two regions
    GAIN = 1  # two planes are likelier than one
    FLAT = 2  # two regions are flat within the settings
    HIDDEN = 3  # pieces that do not touch are one plane


@dataclass(frozen=True)
class Memory:
    """The planes of an image and the evidence for them, none by default."""

    # (R, C) int32: the piece of a plane at the centre of each cell, -1 none
    labels: np.ndarray = field(default_factory=lambda: np.empty((0, 0), np.int32))
    # (K,) int: the plane that each piece is part of, -1 where it is curved
    planes: np.ndarray = field(default_factory=lambda: np.empty(0, int))
    # (R * C,) float64: mean of each cell
    disparity: np.ndarray = field(default_factory=lambda: np.empty(0))
    lens: np.ndarray = field(default_factory=lambda: np.empty(0))  # of the grid
    # (4, K, K) float64: average evidence of each :class:`Decision` for two planes, from -1 to 1,
    # of two pieces, and of parts of one; and of how many images it is
    evidence: np.ndarray = field(default_factory=lambda: np.zeros((len(Decision), 0, 0)))
    images: np.ndarray = field(default_factory=lambda: np.zeros((len(Decision), 0, 0), int))
    noise: Noise = Noise(0.0)  # mean of the last images, in a scene that does not change
    noise_images: float = 0.0  # how many images it counts for

    def for_grid(self, grid: CellGrid) -> Memory:
        """Return the memory usable for an image: none for another size or lens."""
        is_same = self.labels.shape == grid.shape and np.array_equal(self.lens, grid.lens)
        return self if is_same else NO_MEMORY

    def hypotheses(self, grid: CellGrid) -> np.ndarray:
        """Return the planes of the pieces in an image, and the preference for them, (h, 4)."""
        if not len(self.planes):
            return np.empty((0, 4))
        planes = fit_planes(add_up(grid.moments, self.labels.reshape(-1), grid.usable,
                                   len(self.planes)))
        planes = planes[~np.isnan(planes[:, 0])]
        return np.column_stack([planes, np.full(len(planes), PREFERENCE)])

    def images_of_noise(self, grid: CellGrid, noise: Noise) -> float:
        """Return for how many images the noise counts: for none if the whole scene has changed."""
        if self.noise_images == 0 or noise.source_sigma > 0:
            return 0.0
        change = abs(grid.mean[:, 2] - self.disparity)
        is_same = (change < MAX_DEVIATIONS * noise.mean_sigma) & grid.usable
        share = np.count_nonzero(is_same) / max(np.count_nonzero(grid.usable), 1)
        return min(self.noise_images, MOST_IMAGES - 1) * share

    def average_noise(self, grid: CellGrid, noise: Noise) -> Noise:
        """Return the mean of the noise of an image and of those before."""
        images = self.images_of_noise(grid, noise)
        return replace(noise, **{
            name: (images * getattr(self.noise, name) + getattr(noise, name)) / (images + 1)
            for name in MEASURED})


NO_MEMORY = Memory()


class Recall:
    """
    Decisions in one image with the memory of the previous one.

    Parameters
    ----------
    memory : Memory
        For the grid of the cells.
    cells : WeightedCells

    """

    def __init__(self, memory: Memory, cells: WeightedCells) -> None:
        self._memory, self._cells = memory, cells
        self.is_empty = not len(memory.planes)
        self._evidence, self._images = memory.evidence.copy(), memory.images.copy()
        if not self.is_empty:
            change = (abs(cells.table[:, MEAN_D] - memory.disparity)
                      * np.sqrt(cells.table[:, MEAN_WEIGHT]))
            self._has_changed = (change > CHANGED * median(change[cells.is_planar])
                                 if cells.is_planar.any() else cells.is_planar)
            self._has_changed = self._has_changed.reshape(cells.grid.shape)
        self._labels, self._regions = None, []

    @property
    def most(self) -> float:
        """The largest statistic, over its limit, at which regions may stay one plane."""
        return 1.0 if self.is_empty else CLEAR

    def is_two(self, decision: Decision, statistic: float, labels: np.ndarray,
               pair: tuple[int, int], touches: bool = True) -> bool:
        """
        Return whether two regions are two planes: their statistic is above its limit, 1.

        Parameters
        ----------
        decision : Decision
        statistic : float
        labels : (R, C) int32
            Region of each cell; not changed in place between two calls.
        pair : (2,) int
        touches : bool
            Only regions that touch stay two, because an object in front of a plane cuts it in two.

        """
        is_two = statistic > 1
        if self.is_empty or not (is_two or touches):
            return is_two
        if labels is not self._labels:  # of one image, dozens of pairs are asked for
            self._labels, self._regions = labels, _regions_before(
                np.ascontiguousarray(labels), self._memory.labels, self._has_changed,
                len(self._memory.planes)).tolist()
        if max(pair) >= len(self._regions):  # it has no cells
            return is_two
        (one, cells, changed), (other, cells_of_other, changed_of_other) = (
            self._regions[region] for region in pair)
        if cells_of_other < cells:
            cells, changed = cells_of_other, changed_of_other
        if min(one, other) < 0 or 2 * changed > cells:
            return is_two
        at, evidence = (decision, one, other), math.log(max(statistic, 1e-9), CLEAR)
        planes = self._memory.planes
        was_two = planes[one] != planes[other] if decision is Decision.FLAT else one != other
        last, images = self._memory.evidence[at], self._memory.images[at]
        if images == 0:  # the decision of the previous image, whose evidence is unknown
            last, images = (1.0 if was_two else -1.0), 1
        images = min(images, MOST_IMAGES - 1)
        # If asked again in the same image, it counts once.
        average = (images * last + max(evidence, -1.0)) / (images + 1)
        if evidence > 1:  # new objects appear immediately
            average, images = 1.0, 0
        for key in (at, (decision, other, one)):
            self._evidence[key], self._images[key] = average, images + 1
        return average > (JOINS if was_two else PARTS)

    def bend_limits(self, labels: np.ndarray, count: int) -> np.ndarray:
        """Return the factor on the limits at which each region is curved, (count,)."""
        if self.is_empty:
            return np.ones(count)
        shared = self._shared_cells(labels, count)
        most = shared.argmax(axis=1)
        is_known = (most > 0) & (2 * shared.max(axis=1) > shared.sum(axis=1))
        was_flat = self._memory.planes[most - 1] >= 0
        return np.where(is_known, np.where(was_flat, CLEARLY_CURVED, 1 / CLEARLY_CURVED), 1.0)

    def after(self, labels: np.ndarray, planes: np.ndarray, noise: Noise) -> Memory:
        """
        Return the memory of an image.

        Parameters
        ----------
        labels : (H, W) int32
            Pieces of the pixels.
        planes : (K,) int
            Of the pieces.
        noise : Noise
            Averaged.

        """
        grid = self._cells.grid
        # A single image is searched with the estimate from which its noise was measured.
        images = 0.0 if self.is_empty else self._memory.images_of_noise(grid, noise) + 1
        cells, half = np.full(grid.shape, -1, np.int32), grid.size_px // 2
        centres = labels[half::grid.size_px, half::grid.size_px]
        cells[:centres.shape[0], :centres.shape[1]] = centres
        return Memory(cells, planes, grid.mean[:, 2], grid.lens,
                      *self._evidence_of(cells, len(planes)), noise, images)

    def _evidence_of(self, labels: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the evidence for the pieces of this image, and the images that it is of."""
        if self.is_empty:
            shape = len(Decision), count, count
            return np.zeros(shape), np.zeros(shape, int)
        cells = self._shared_cells(labels, count)
        shared = cells[:, 1:]
        if not shared.size:
            return np.zeros((len(Decision), 0, 0)), np.zeros((len(Decision), 0, 0), int)
        before, now = shared.argmax(axis=1), shared.argmax(axis=0)
        evidence, images = (part[:, before[:, None], before] for part in
                            (self._evidence, self._images))
        is_new = 2 * shared.max(axis=1) <= cells.sum(axis=1)
        images[:, is_new], images[:, :, is_new] = 0, 0
        for other in np.flatnonzero(shared.max(axis=0)):  # parts of one that were two pieces
            piece = now[other]
            one = before[piece]
            if one != other:
                evidence[:, piece, piece] = self._evidence[:, one, other]
                images[:, piece, piece] = self._images[:, one, other]
        return evidence, images

    def _shared_cells(self, labels: np.ndarray, count: int) -> np.ndarray:
        """Return how many cells each region shares with no piece and each, (count, 1 + K)."""
        stride = len(self._memory.planes) + 1
        return np.bincount(((labels + 1) * stride + self._memory.labels + 1).reshape(-1),
                           minlength=(count + 1) * stride).reshape(-1, stride)[1:]


@kernel('int64[:, ::1](int32[:, ::1], int32[:, ::1], boolean[:, ::1], int64)', is_short=True)
def _regions_before(labels, last, has_changed, count):
    """Return the piece that most of each region was, -1 if none, its cells, and the changed."""
    most = np.int32(-1)
    for row in range(labels.shape[0]):
        for column in range(labels.shape[1]):
            most = max(most, labels[row, column])
    shared, found = np.zeros((most + 1, count + 1), np.int64), np.zeros((most + 1, 3), np.int64)
    for row in range(labels.shape[0]):
        for column in range(labels.shape[1]):
            label = labels[row, column]
            if label >= 0:
                shared[label, last[row, column] + 1] += 1
                found[label, 1] += 1
                found[label, 2] += has_changed[row, column]
    for label in range(most + 1):
        piece = shared[label].argmax()
        found[label, 0] = piece - 1 if 2 * shared[label, piece] > found[label, 1] else -1
    return found
