# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The largest network input that keeps a rate on this machine, found by timing."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np

from plane_detector.stopping import Background, raise_if_stopped

# The first run at an input size allocates memory; the median of the next ones is used.
REPEATS = 3
# derived: one other busy program leaves a network with two threads two thirds of two cores. What
# takes no longer than that may have been disturbed, and is timed a second time.
DISTURBED = 1.5
# Largest share of the period for the network, and of the cores for all work on a frame, so that a
# slow frame is not late.
LOAD = 0.9
# Core time of all work beside the network, as a multiple of that of the stages alone. derived: 53
# ms with all outputs, with receiving, publishing and their subscriber, for 25 ms of the stages.
ALL_OF_STAGES = 2.0


def largest_within(sizes: Sequence[int], seconds_of: Callable[[int], float],
                   limit_s: float) -> tuple[int, Mapping[int, float]]:
    """
    Find the largest size whose time is within a limit, by bisection.

    A size that is a little too slow is timed a second time, and the shorter time counts: other
    programs only ever make it longer, and bisection never comes back to a size that it has passed.

    Parameters
    ----------
    sizes : sequence of int
        Ascending; at least one.
    seconds_of : callable
        Returns the time of a size, s; larger sizes take longer.
    limit_s : float

    Returns
    -------
    size : int
        The smallest size if all take longer.
    seconds : mapping of int to float
        Measured times.

    Examples
    --------
    >>> largest_within((98, 112, 126, 140), lambda side: side**2 / 1e5, 0.16)
    (126, {140: 0.196, 112: 0.12544, 126: 0.15876})

    """
    def shortest_s(size: int) -> float:
        first_s = seconds_of(size)
        is_doubtful = limit_s < first_s <= DISTURBED * limit_s
        return min(first_s, seconds_of(size)) if is_doubtful else first_s
    seconds = {sizes[-1]: shortest_s(sizes[-1])}
    if seconds[sizes[-1]] <= limit_s:
        return sizes[-1], seconds
    fits, too_slow = -1, len(sizes) - 1
    while too_slow - fits > 1:
        middle = (fits + too_slow) // 2
        seconds[sizes[middle]] = shortest_s(sizes[middle])
        if seconds[sizes[middle]] <= limit_s:
            fits = middle
        else:
            too_slow = middle
    return sizes[max(fits, 0)], seconds


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


def core_seconds(run: Callable[[], object]) -> float:
    """Return the core time of a call, of all threads of this process, after a warm-up call."""
    run()
    times = []
    for _ in range(2):  # other threads may work meanwhile, but only now and then
        start_s = time.process_time()
        run()
        times.append(time.process_time() - start_s)
    return min(times)


def core_count() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else os.cpu_count()


@contextmanager
def beside(work: Callable[[], object], period_s: float) -> Iterator[None]:
    """Run other work once per period in its own thread while this block runs."""
    ended = threading.Event()

    def repeat() -> None:
        while not ended.is_set():
            start_s = time.perf_counter()
            work()
            ended.wait(max(period_s - (time.perf_counter() - start_s), 0.0))
    thread = Background(repeat, 'plane_stage')
    try:
        yield
    finally:
        ended.set()
        thread.result()


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
