# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The largest network input that keeps a rate on this machine, from the times of two sizes."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from plane_detector.stopping import raise_if_stopped

# The first run at an input size allocates memory; the median of the next ones is used.
REPEATS = 3
# derived: a tenth of the period is left, so that a frame that takes a little longer is not late.
LOAD = 0.9


def largest_within(sizes: Sequence[int], seconds_of: Callable[[int], float], limit_s: float,
                   power: int = 2) -> tuple[int, Mapping[int, float]]:
    """
    Find the largest size whose time is within a limit; only the largest and smallest are timed.

    Parameters
    ----------
    sizes : sequence of int
        Ascending; at least one.
    seconds_of : callable
        Returns the time of a size, s.
    limit_s : float
    power : int
        The time is affine in this power of the size.

    Returns
    -------
    size : int
        The smallest size if all take longer.
    seconds : mapping of int to float
        Measured times.

    Examples
    --------
    >>> largest_within((98, 112, 126, 140), lambda side: side**2 / 1e5, 0.16)
    (126, {140: 0.196, 98: 0.09604})

    """
    smallest, largest = sizes[0], sizes[-1]
    seconds = {largest: seconds_of(largest)}
    if seconds[largest] <= limit_s or smallest == largest:
        return largest, seconds
    seconds[smallest] = seconds_of(smallest)
    powers = smallest**power, largest**power
    fitting = [size for size in sizes if np.interp(
        size**power, powers, (seconds[smallest], seconds[largest])) <= limit_s]
    return max(fitting, default=smallest), seconds


def median_seconds(run: Callable[[], object]) -> float:
    """Return the median time of a few calls in seconds, after a warm-up call."""
    run()
    times = []
    for _ in range(REPEATS):
        raise_if_stopped()
        start_s = time.perf_counter()
        run()
        times.append(time.perf_counter() - start_s)
    return float(np.median(times))


def side_for(short_side: int, share: float, sizes: Sequence[int]) -> int | None:
    """
    Return the largest size expected to take this share of the present time; None if there is none.

    The time of a network is assumed proportional to the number of input pixels.

    Examples
    --------
    >>> side_for(280, 0.25, range(98, 281, 14))
    140
    >>> side_for(280, 0.01, range(98, 281, 14)) is None
    True

    """
    fitting = [side for side in sizes if (side / short_side) ** 2 <= share]
    return max(fitting, default=None)
