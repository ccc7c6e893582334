# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
What one image of a stream leaves for the next.

Noise is fresh in each image, and yes-or-no decisions that it tips make planes blink. The planes
of the image before, fitted to the depth now under their cells, are more hypotheses of the search:
where the camera or a thing has moved they fit badly, and others win. What was one plane stays one,
and what was two, until a statistic is clear of its limit. A region without a plane before is
judged by its image alone. The noise is measured anew in each image: carried over, it would grow.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from plane_detector.segmentation.cells.grid import CellGrid
from plane_detector.segmentation.cells.model import add_up
from plane_detector.segmentation.cells.plane_fit import fit_planes

# The support of a plane of the image before counts so many times.
PREFERENCE = 1.3
# By so many times must a statistic be above its limit, or below it, to change what was decided in
# the image before: that pieces are one plane, and that they are curved.
CLEAR, CLEARLY_CURVED = 3.0, 2.0


@dataclass(frozen=True)
class Memory:
    """The planes of an image, none by default."""

    # (R, C) int32: the piece of a plane at the centre of each cell, -1 none
    labels: np.ndarray = field(default_factory=lambda: np.empty((0, 0), np.int32))
    # (K,) int: the plane that each piece is part of, -1 where it is curved
    planes: np.ndarray = field(default_factory=lambda: np.empty(0, int))
    lens: np.ndarray = field(default_factory=lambda: np.empty(0))  # of the grid

    @classmethod
    def of(cls, grid: CellGrid, labels: np.ndarray, planes: np.ndarray) -> Memory:
        """Return the memory of pieces of planes, by the labels (H, W) of pixels."""
        cells, half = np.full(grid.shape, -1, np.int32), grid.size_px // 2
        centres = labels[half::grid.size_px, half::grid.size_px]
        cells[:centres.shape[0], :centres.shape[1]] = centres
        return cls(cells, planes, grid.lens)

    @property
    def most(self) -> float:
        """The largest statistic, over its limit, at which regions may stay one plane."""
        return CLEAR if self.is_known else 1.0

    @property
    def is_known(self) -> bool:
        """Whether there is any plane in it."""
        return len(self.planes) > 0

    def for_image(self, grid: CellGrid) -> Memory:
        """Return what is left of it in an image: nothing of one of another size or lens."""
        is_same = self.labels.shape == grid.shape and np.array_equal(self.lens, grid.lens)
        return self if is_same else NO_MEMORY

    def hypotheses(self, grid: CellGrid) -> np.ndarray:
        """Return the planes of the pieces in an image, and the preference for them, (h, 4)."""
        if not self.is_known:
            return np.empty((0, 4))
        moments = add_up(grid.moments, self.labels.reshape(-1), grid.usable, len(self.planes))
        planes = fit_planes(moments)
        planes = planes[~np.isnan(planes[:, 0])]
        return np.column_stack([planes, np.full(len(planes), PREFERENCE)])

    def is_two(self, statistic: float, labels: np.ndarray, pair: tuple[int, int],
               touches: bool = True, is_joined: bool = False) -> bool:
        """
        Return whether two regions are two planes: their statistic is above its limit, 1.

        Parameters
        ----------
        statistic : float
        labels : (R, C) int32
            Region of each cell.
        pair : (2,) int
        touches : bool
            Only regions that touch stay two: what hides a plane behind it cuts it in two.
        is_joined : bool
            Whether pieces of a plane that is flat within the settings were one.

        """
        if not self.is_known or not (1 / CLEAR if touches else 1) < statistic <= CLEAR:
            return statistic > 1
        one, other = (self._piece(labels == region) for region in pair)
        if one < 0 or other < 0:
            return statistic > 1
        return bool(self.planes[one] != self.planes[other] if is_joined else one != other)

    def bend_limits(self, labels: np.ndarray, count: int) -> np.ndarray:
        """Return how many times the limits each region must be bent to be curved, (count,)."""
        factors = np.ones(count)
        for k in range(count if self.is_known else 0):
            piece = self._piece(labels == k)
            if piece >= 0:
                factors[k] = 1 / CLEARLY_CURVED if self.planes[piece] < 0 else CLEARLY_CURVED
        return factors

    def _piece(self, is_inside: np.ndarray) -> int:
        """Return the piece that most of some cells (R, C) bool belonged to, -1 if none."""
        counts = np.bincount(self.labels[is_inside] + 1, minlength=1)
        most = int(counts.argmax())
        return most - 1 if 2 * counts[most] > counts.sum() else -1


NO_MEMORY = Memory()
