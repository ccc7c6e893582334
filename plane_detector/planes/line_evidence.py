# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Lines of the image inside regions: a line along an axis cannot lie in a plane across it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
    return RegionLines(segments, _region_shares(segments, labels, count).T * segments.lengths)


def _region_shares(segments: LineSegments, labels: np.ndarray, count: int) -> np.ndarray:
    """Return the share (N, K) of both sides of each segment that lies in each region."""
    start, end = segments.ends_px[:, 0], segments.ends_px[:, 1]
    along = end - start
    across = np.stack([-along[:, 1], along[:, 0]], 1) / np.linalg.norm(along, axis=1)[:, None]
    steps = np.linspace(0.1, 0.9, SAMPLES)[:, None]
    middle = start[:, None] + steps * along[:, None]
    points = np.concatenate([middle + side * across[:, None] for side in (-SIDE_PX, SIDE_PX)], 1)
    column, row = np.rint(points).astype(int).transpose(2, 0, 1)
    found = labels[row.clip(0, labels.shape[0] - 1), column.clip(0, labels.shape[1] - 1)]
    index = found + 1 + (count + 1) * np.arange(len(segments))[:, None]
    counts = np.bincount(index.ravel(), minlength=len(segments) * (count + 1))
    return counts.reshape(len(segments), count + 1)[:, 1:] / (2 * SAMPLES)
