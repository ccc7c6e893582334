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

from plane_detector._runtime.compilation import kernel
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
    nadir = (float(intrinsics.fx * down[0] + intrinsics.cx * down[2]),
             float(intrinsics.fy * down[1] + intrinsics.cy * down[2]), float(down[2]))
    lines, count = [], 0
    for axis in (1, 0):  # lines are rows, columns
        for sign in (-1, 1):
            sector, ways = _sector((axis, sign, count), (intrinsics.width, intrinsics.height),
                                   nadir)
            lines.append(sector)
            count += ways
    return Ways(np.concatenate(lines), count)


@kernel('Tuple((int64[:, ::1], int64))(UniTuple(int64, 3), UniTuple(int64, 2), '
        'UniTuple(float64, 3))', is_short=True)
def _sector(part, sides, nadir):
    """Return the lines and the number of ways of a sector, which are numbered from ``first``."""
    (axis, sign, first), nadir_z = part, nadir[2]
    across, far = nadir[1 - axis], sides[1 - axis]
    lines, away = np.zeros((sides[axis], 10), np.int64), np.empty(sides[axis])
    # How far the ways are from the nadir, times nadir_z, is at least half a pixel.
    n, least = 0, 0.5 * abs(nadir_z)
    for i in range(len(lines)):
        at = i if sign > 0 else len(lines) - 1 - i
        off = sign * (at * nadir_z - nadir[axis])
        if off < (-least if sign < 0 else 0.0):
            continue
        off, low, high = max(off, max(least, 1e-9)), 0.0, 0.0
        if abs(nadir_z) > 1e-6:
            one, other = (across - off) / nadir_z, (across + off) / nadir_z
            low = min(max(np.floor(min(one, other)), 0.0), far)
            high = min(max(np.ceil(max(one, other)) + 1, 0.0), far)
        elif abs(across) <= off:
            high = np.float64(far)
        if low < high:
            lines[n, V if axis else U], lines[n, DU if axis else DV] = at, 1
            lines[n, LOW], lines[n, HIGH], away[n] = int(low), int(high), off
            n += 1
    if n == 0:
        return lines[:0].copy(), 0
    nearest, farthest = away[0], away[0]
    for i in range(n):
        nearest, farthest = min(nearest, away[i]), max(farthest, away[i])
    wanted, reference = max(nearest, _REFERENCE_SHARE * farthest), 0
    for i in range(n):
        if abs(away[i] - wanted) < abs(away[reference] - wanted):
            reference = i
    of_reference, at = away[reference], lines[reference, V if axis else U]
    shift, begin, start = np.empty(n), np.empty(n), np.inf
    for i in range(n):
        shift[i] = sign * across * (at - lines[i, V if axis else U]) / of_reference
        begin[i] = (lines[i, LOW] - 0.5 - shift[i]) / (away[i] / of_reference)
        start = min(start, np.floor(begin[i]))
    ways, unit = np.int64(0), 1 << FRACTION_BITS
    for i in range(n):
        spread = away[i] / of_reference
        step, origin = int(np.rint(spread * unit)), int(np.rint(
            (shift[i] + spread * start + 0.5) * unit))
        # Of the rounded steps: close to the nadir they are a few units, and thousands pass a line.
        end = -((origin - lines[i, HIGH] * unit) // step)
        ways = max(ways, end)
        lines[i, START], lines[i, STEP] = origin - first * step, step
        lines[i, FIRST], lines[i, END] = int(np.floor(begin[i]) - start) + first, end + first
    return lines[:n].copy(), ways
