# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Memory of the node, whose worker threads process one frame after the other.

By default every frame caused 2000 to 9000 page faults, a fifth of the processor time per frame.
"""

from __future__ import annotations

import ctypes
import gc

from plane_detector import memory

# derived: value from <malloc.h> of glibc.
_M_ARENA_MAX = -8


def retain_freed_memory() -> bool:
    """
    Make the C library keep freed memory for the next frame, in one heap for all threads.

    The heaps of other threads would be returned completely whatever the thresholds. Must be called
    before threads are started; see :func:`plane_detector.memory.retain_freed_memory`.
    """
    return memory.retain_freed_memory() and bool(ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 1))


def freeze_loaded_objects() -> None:
    """
    Exclude existing objects, such as modules and the network, from garbage collection.

    Full collections visited 190000 objects, most of them numba's, which took .1 s in the middle
    of a frame, every ten or twenty frames.
    """
    gc.unfreeze()
    gc.collect()
    gc.freeze()
