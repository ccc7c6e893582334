# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Memory of a process that works on one frame after the other.

Every frame needs the same megabytes for a short time. By default the GNU C library returns freed
memory to the kernel at once, which clears every page again for the next frame: measured 2000 to
9000 page faults and a fifth of the processor time per frame.
"""

from __future__ import annotations

import ctypes
import gc
import os

# Values from <malloc.h>.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
_LARGEST_MMAP_THRESHOLD = 32 * 1024 * 1024  # the library refuses more
_KEPT = 256 * 1024 * 1024


def keep_freed_memory() -> bool:
    """
    Make the C library keep freed memory for the next frame, at most 256 MB at the end of the heap.

    There is one heap for all threads, because those of other threads are returned completely
    whatever the thresholds. Must be called before threads are started. Settings of the user by
    MALLOC_* or GLIBC_TUNABLES in the environment take precedence.

    Returns
    -------
    bool
        False with another C library, or if the user has set the thresholds.

    """
    if any(name.startswith('MALLOC_') or name == 'GLIBC_TUNABLES' for name in os.environ):
        return False
    mallopt = getattr(ctypes.CDLL(None), 'mallopt', None)
    return mallopt is not None and all([
        mallopt(_M_MMAP_THRESHOLD, _LARGEST_MMAP_THRESHOLD),
        mallopt(_M_TRIM_THRESHOLD, _KEPT),
        mallopt(_M_ARENA_MAX, 1)])


def freeze_loaded_objects() -> None:
    """
    Exclude existing objects, such as modules and the network, from garbage collection.

    Full collections visited 190000 objects, most of them numba's, which took .1 s in the middle
    of a frame, every ten or twenty frames.
    """
    gc.unfreeze()
    gc.collect()
    gc.freeze()
