# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Limits to one thread: for the matrix products of the paper's method, a worker, or a process.

The products are so small that waking a second thread takes longer than the product. With the
other cores busy with the network or other programs, a product takes twice as long.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, wraps
from typing import ParamSpec, TypeVar

import cv2
from threadpoolctl import ThreadpoolController, threadpool_limits

P, R = ParamSpec('P'), TypeVar('R')


@cache
def _libraries() -> list:
    """Find the linear algebra libraries once; numpy's is already loaded."""
    return ThreadpoolController().select(user_api='blas').lib_controllers


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function to run its linear algebra on one thread."""
    @wraps(function)
    def on_one_thread(*args: P.args, **kwargs: P.kwargs) -> R:
        before = [library.num_threads for library in _libraries()]
        if all(count == 1 for count in before):  # as in a nested call
            return function(*args, **kwargs)
        for library in _libraries():
            library.set_num_threads(1)
        try:
            return function(*args, **kwargs)
        finally:
            for library, count in zip(_libraries(), before, strict=True):
                library.set_num_threads(count)
    return on_one_thread


def use_one_thread() -> None:
    """Keep OpenCV, BLAS and OpenMP of this process to one thread from now on."""
    cv2.setNumThreads(1)
    threadpool_limits(1)


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep OpenCV, BLAS and OpenMP to one thread."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with threadpool_limits(1):
            yield
    finally:
        cv2.setNumThreads(before)
