# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Memory of a process that works on one frame after the other.

Every frame needs the same megabytes for a moment. By its defaults the GNU C library gives freed
memory back to the kernel at once, and the kernel clears every page of it again for the next
frame: measured 2000 to 9000 page faults and a fifth of the processor time per frame.
"""

from __future__ import annotations

import ctypes
import gc
import os

# The numbers of <malloc.h>.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
_LARGEST_MMAP_THRESHOLD = 32 * 1024 * 1024  # the library refuses more
_KEPT = 256 * 1024 * 1024


def keep_freed_memory() -> bool:
    """
    Let the C library keep freed memory for the next frame; at most 256 MB at the heap's end.

    There is one heap for all threads, because those of other threads are given back whole
    whatever the thresholds. To be called before threads are started. What the user has set by
    MALLOC_* or GLIBC_TUNABLES in the environment stands.

    Returns
    -------
    bool
        Whether it is so now; not where the C library is another one, or the user has set it.

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
    Let the garbage collector pass over what is there now, as modules and the network.

    Its full passes looked at 190000 objects, most of them numba's, which took .1 s in the middle
    of a frame, every ten or twenty frames.
    """
    gc.unfreeze()
    gc.collect()
    gc.freeze()
