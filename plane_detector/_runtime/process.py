# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Memory and threads of a process that processes one frame after the other."""

from __future__ import annotations

import ctypes
import gc
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from functools import cache

import cv2
from threadpoolctl import ThreadpoolController, threadpool_limits

# derived: values from <malloc.h> of glibc, and the largest threshold that it accepts.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _LARGEST_MMAP_THRESHOLD = -1, -3, 32 * 2**20
_M_ARENA_MAX = -8
# derived: about fifty float32 images of 1280 x 720.
_KEPT_BYTES = 256 * 2**20


@cache
def retain_freed_memory(one_heap: bool = False) -> bool:
    """
    Make the C library keep up to 256 MB of freed memory for the next frame; once per process.

    A frame allocates and frees about fifty arrays of the size of the image. By default glibc
    returns each to the kernel, which clears its pages again: 2000 to 9000 page faults, a fifth of
    the processor time of a frame. Settings of the user in the environment take precedence.

    Parameters
    ----------
    one_heap : bool
        Use one heap for all threads, because the heaps of other threads are returned whatever the
        thresholds; only before threads are started.

    Returns
    -------
    bool
        False with another C library, or if the user has set MALLOC_* or GLIBC_TUNABLES.

    """
    if any(name.startswith('MALLOC_') or name == 'GLIBC_TUNABLES' for name in os.environ):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return False
    return bool(mallopt(_M_MMAP_THRESHOLD, _LARGEST_MMAP_THRESHOLD)
                and mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)
                and (not one_heap or mallopt(_M_ARENA_MAX, 1)))


def tidy_after_loading() -> None:
    """
    Collect garbage now, not in the middle of a frame; return the memory freed by loading.

    The next full collection then happens when there are a quarter more objects: none in 600
    frames. Without this there was one, of .08 s.
    """
    gc.collect()
    with suppress(AttributeError, OSError, TypeError):  # another C library than glibc
        ctypes.CDLL(None).malloc_trim(0)


def use_one_thread() -> None:
    """Keep OpenCV, BLAS and OpenMP of this process to one thread from now on."""
    cv2.setNumThreads(1)
    threadpool_limits(1)


_limiting = threading.Lock()  # held by the block that limits the threads of the process


@cache
def _libraries() -> ThreadpoolController:
    """Return the libraries with their own threads; searching for them takes 13 ms."""
    return ThreadpoolController()


@contextmanager
def one_thread() -> Iterator[None]:
    """
    Keep OpenCV, BLAS and OpenMP to one thread in a block, or in the decorated function.

    These are limits of the process, and only the thread that sets them can lift them: of blocks
    within each other, or at the same time in several threads, the first one to begin sets them,
    and at its end the process has the threads of before.
    """
    if not _limiting.acquire(blocking=False):
        yield
        return
    before = cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        # To limit them takes 60 microseconds, to see that they are limited takes 2.
        is_limited = all(one.num_threads == 1 for one in _libraries().lib_controllers)
        with nullcontext() if is_limited else _libraries().limit(limits=1):
            yield
    finally:
        cv2.setNumThreads(before)
        _limiting.release()
