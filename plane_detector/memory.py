# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Memory of a process that works on one frame after the other.

A frame allocates and frees about fifty arrays of the size of the image. By default glibc returns
each to the kernel, which clears its pages again for the next one: on sensor depth this takes as
long as all the arithmetic.
"""

from __future__ import annotations

import ctypes
import os
from functools import cache

# derived: values from <malloc.h> of glibc, and the largest threshold that it accepts.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _LARGEST_MMAP_THRESHOLD = -1, -3, 32 * 2**20
# derived: about fifty float32 images of 1280 x 720.
KEPT_BYTES = 256 * 2**20


@cache
def retain_freed_memory() -> bool:
    """
    Make the C library keep up to 256 MB of freed memory; once per process.

    Settings of the user by MALLOC_* or GLIBC_TUNABLES in the environment take precedence.

    Returns
    -------
    bool
        False with another C library, or if the user has set the thresholds.

    """
    if any(name.startswith('MALLOC_') or name == 'GLIBC_TUNABLES' for name in os.environ):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return False
    return bool(mallopt(_M_MMAP_THRESHOLD, _LARGEST_MMAP_THRESHOLD)
                and mallopt(_M_TRIM_THRESHOLD, KEPT_BYTES))
