# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Freed memory stays with the process.

A frame allocates and frees some fifty arrays of the size of the image. As it comes, glibc returns
each to the kernel and asks for zeroed pages again for the next: on depth of a sensor that takes as
long as all the arithmetic.
"""

from __future__ import annotations

import ctypes
from functools import cache

# derived: names of malloc.h of glibc, and the largest threshold that it takes.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _LARGEST_MMAP_THRESHOLD = -1, -3, 32 * 2**20
# derived: some fifty float32 images of 1280 x 720.
KEPT_BYTES = 256 * 2**20


@cache
def keep_freed_memory() -> bool:
    """
    Let the allocator keep up to 256 MB that are free, for the process, once.

    Returns
    -------
    bool
        Whether the allocator of this system can be told; others are left as they are.

    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return False
    return bool(mallopt(_M_MMAP_THRESHOLD, _LARGEST_MMAP_THRESHOLD)
                and mallopt(_M_TRIM_THRESHOLD, KEPT_BYTES))
