# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Ways of a robot over the ground, in an image of any orientation.

Straight away from the point under the camera, a way is a line in the image that starts at the
image of the direction down (the nadir, a vanishing point), wherever that is: below a camera that
looks ahead, at the side of one on its side, in the middle of one that looks straight down. With
n = K down and a pixel p = (u, v), the way at p leads in the direction p n_z - (n_x, n_y).

The image is cut along the two diagonals through the nadir into at most four sectors, in which the
ways lead up, down, left or right. Lines of pixels across the ways, the nearest first, pass all
ways of a sector at once: rows of the image in two sectors, columns in the others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.types import CameraIntrinsics

# Ways are a pixel apart in this share of the largest distance from the nadir, or where the image
# begins: at most 2 pixels apart, and none is followed in vain where they are narrow.
_REFERENCE_SHARE = 0.5
# Positions are in this share of a pixel.
FRACTION_BITS = 16
# derived: the columns of `Ways.lines`.
U, V, DU, DV, START, STEP, FIRST, END, LOW, HIGH = range(10)


@dataclass(frozen=True)
class Ways:
    """
    Lines of pixels across all ways.

    A row of ``lines`` (L, 10) int64 is u and v at position 0 of the line, the steps of u and v,
    the position of way 0 and the distance of ways along the line (in 2**-16 pixels), the first way
    and the end of the ways that pass the line, and its first position and the end of them. Way w
    is at ``(start + w * step) >> 16`` and stands for all pixels up to the next way.
    """

    lines: np.ndarray
    count: int

    @property
    def for_loops(self) -> tuple[np.ndarray, int]:
        """Lines and number of the ways, as the compiled loops take them."""
        return self.lines, self.count


def ways_over_ground(intrinsics: CameraIntrinsics, down: np.ndarray) -> Ways:
    """
    Return the ways of an image.

    Parameters
    ----------
    intrinsics : CameraIntrinsics
    down : (3,) floating
        Unit direction of gravity in the optical frame.

    Returns
    -------
    Ways

    Examples
    --------
    A camera that looks ahead: the ways are its columns, from the bottom to the top.

    >>> camera = CameraIntrinsics(fx=4.0, fy=4.0, cx=1.0, cy=1.0, width=3, height=3)
    >>> ways_over_ground(camera, np.array([0.0, 1.0, 0.0])).lines[:, 1].tolist()
    [2, 1, 0]

    One that looks straight down: four sectors of two lines each.

    >>> len(ways_over_ground(camera, np.array([0.0, 0.0, 1.0])).lines)
    8

    """
    nadir = (intrinsics.fx * down[0] + intrinsics.cx * down[2],
             intrinsics.fy * down[1] + intrinsics.cy * down[2])
    sides = intrinsics.width, intrinsics.height
    lines, count = [], 0
    for axis in (1, 0):  # lines are rows, columns
        for sign in (-1, 1):
            sector, ways = _sector(axis, sign, sides, nadir, float(down[2]), count)
            lines.append(sector)
            count += ways
    return Ways(np.concatenate(lines), count)


def _sector(axis: int, sign: int, sides: tuple[int, int], nadir: tuple[float, float],
            nadir_z: float, first: int) -> tuple[np.ndarray, int]:
    """Return the lines and the number of ways of a sector, which are numbered from ``first``."""
    across = 1 - axis
    at = np.arange(sides[axis])[::sign]
    # How far the ways are from the nadir, times nadir_z; at least half a pixel.
    away = sign * (at * nadir_z - nadir[axis])
    least = 0.5 * abs(nadir_z)
    at, away = at[away >= -least * (sign < 0)], away[away >= -least * (sign < 0)]
    away = np.maximum(away, max(least, 1e-9))
    if abs(nadir_z) > 1e-6:
        ends = (nadir[across] + np.outer((-1, 1), away)) / nadir_z
        low, high = np.floor(ends.min(axis=0)), np.ceil(ends.max(axis=0)) + 1
        low, high = np.clip([low, high], 0, sides[across]).astype(np.int64)
    else:
        low = np.zeros(len(at), np.int64)
        high = np.where(abs(nadir[across]) <= away, sides[across], 0)
    keep = low < high
    at, away, low, high = at[keep], away[keep], low[keep], high[keep]
    if not len(at):
        return np.zeros((0, 10), np.int64), 0
    reference = int(abs(away - max(away.min(), _REFERENCE_SHARE * away.max())).argmin())
    spread = away / away[reference]
    shift = sign * nadir[across] * (at[reference] - at) / away[reference]
    start = np.floor(((low - 0.5 - shift) / spread).min())
    begin = np.floor((low - 0.5 - shift) / spread) - start
    unit = 1 << FRACTION_BITS
    step = np.rint(spread * unit).astype(np.int64)
    origin = np.rint((shift + spread * start + 0.5) * unit).astype(np.int64)
    # Of the rounded steps: close to the nadir they are a few units, and thousands pass a line.
    end = -((origin - high * unit) // step)
    ways, zero, one = int(end.max()), np.zeros(len(at), np.int64), np.ones(len(at), np.int64)
    place = (zero, at, one, zero) if axis else (at, zero, zero, one)
    return np.column_stack([*place, origin - first * step, step, begin.astype(np.int64) + first,
                            end + first, low, high]), ways
