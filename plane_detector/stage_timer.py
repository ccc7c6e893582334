# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Timing of the stages of a pipeline, and of a call."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from plane_detector._runtime.stopping import raise_if_stopped


class StageTimer:
    """
    Measures the wall-clock time of named stages.

    Attributes
    ----------
    seconds : dict of str to float
        In the order of the stages.

    Examples
    --------
    >>> stages = StageTimer()
    >>> with stages('depth'):
    ...     total = sum(range(10))
    >>> list(stages.seconds)
    ['depth']

    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Time the block; raises Stopped if a stop was requested before it."""
        raise_if_stopped()
        start = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - start
