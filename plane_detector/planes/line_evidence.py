# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Lines of the image inside regions: a line along an axis cannot lie in a plane across it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.directions.frames import misalignment
from plane_detector.directions.line_segments import LineSegments

# A segment belongs to the regions at this distance on both sides of it.
SIDE_PX = 4.0
SAMPLES = 9
# chosen: gravity and the first pair of horizontal axes. Further pairs belong to few walls or to
# furniture: their lines show which planes may be perpendicular to them, but exclude no plane.
MAIN_AXES = 3
# tuned: python -m plane_detector.evaluation.benchmark orientation, flat from 2 to 3.
AXIS_TOLERANCE_DEG = 2.5
# Total line length, at unit focal length, that has half the weight of many lines.
HALF_LENGTH = 0.15
# tuned: planes of hexagonal rooms under smooth errors of 0.02 per metre, seeds 300 to 309: error
# of 0.9 degrees at this value, 1.1 at three times as much, 1.7 without further pairs.
MIN_PAIR_SHARE = 0.1
# Sines of the angle between line and plane: below the first the line may lie in the plane, above
# the second it cannot. chosen: normals of networks have errors of 10 to 20 degrees.
MAY_LIE, CANNOT_LIE = 0.2, 0.5


@dataclass(frozen=True)
class LineEvidence:
    """Lines along known axes in each region."""

    axes: np.ndarray  # (A, 3) float64: unit directions: gravity, then pairs of horizontal axes
    # (K, A) float64: share of the line length in each region along each axis; reduced if the
    # length is small
    shares: np.ndarray

    def allows(self) -> np.ndarray:
        """
        Return the axes (K, A), bool, that each plane may be perpendicular to.

        An axis of a further pair requires lines along the other axis of the pair in the plane.
        """
        allowed = np.ones(self.shares.shape, bool)
        for first in range(MAIN_AXES, len(self.axes), 2):
            allowed[:, first:first + 2] = self.shares[:, [first + 1, first]] >= MIN_PAIR_SHARE
        return allowed

    def contradiction(self, normals: np.ndarray) -> np.ndarray:
        """Return the share (K, C) of lines that cannot lie in planes of normals (K, C, 3)."""
        sine = np.abs(normals @ self.axes[:MAIN_AXES].T)
        cannot = np.clip((sine - MAY_LIE) / (CANNOT_LIE - MAY_LIE), 0.0, 1.0)
        return (cannot * self.shares[:, None, :MAIN_AXES]).sum(-1)


@dataclass(frozen=True)
class RegionLines:
    """Lines of the image and the regions next to them."""

    segments: LineSegments
    # (K, N) float64: of each segment in each region, half of it for either side, at unit focal
    # length
    lengths: np.ndarray

    def along(self, axes: np.ndarray) -> LineEvidence:
        """Return the evidence of the segments that are along one of the axes (A, 3)."""
        sine = np.abs(misalignment(self.segments, axes))
        along = np.arange(len(axes)) == sine.argmin(1)[:, None]
        along &= sine < np.sin(np.radians(AXIS_TOLERANCE_DEG))
        total = self.lengths.sum(1, keepdims=True) + HALF_LENGTH
        return LineEvidence(axes, self.lengths @ along / total)


def lines_in_regions(segments: LineSegments, labels: np.ndarray, count: int) -> RegionLines:
    """Assign the lines of the image to regions by their labels (H, W), -1 for none."""
    beside = _samples_beside(np.ascontiguousarray(segments.ends_px), np.ascontiguousarray(labels),
                             count)
    return RegionLines(segments, beside / (2 * SAMPLES) * segments.lengths)


@kernel('int64[:, ::1](float64[:, :, ::1], int32[:, ::1], int64)', is_short=True,
        subject='network')
def _samples_beside(ends_px, labels, count):
    """Return the number (K, N) of samples on both sides of each segment in each region."""
    found, (height, width) = np.zeros((count, len(ends_px)), np.int64), labels.shape
    for i in range(len(ends_px)):
        x, y = ends_px[i, 0, 0], ends_px[i, 0, 1]
        along_x, along_y = ends_px[i, 1, 0] - x, ends_px[i, 1, 1] - y
        aside = SIDE_PX / np.sqrt(along_x * along_x + along_y * along_y)
        for k in range(SAMPLES):
            share = 0.1 + 0.8 * k / (SAMPLES - 1)
            for side in (-aside, aside):
                column = round(x + share * along_x - side * along_y)
                row = round(y + share * along_y + side * along_x)
                region = labels[min(max(row, 0), height - 1), min(max(column, 0), width - 1)]
                if region >= 0:
                    found[region, i] += 1
    return found
