# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The node's process keeps the memory of a frame for the next one."""

import gc
import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from plane_detector.ros.allocator import freeze_loaded_objects

ROOT = Path(__file__).resolve().parents[2]
FRAMES, ARRAYS = 20, 30
PROGRAM = f"""
import resource, sys, threading
import numpy as np
from plane_detector.ros.allocator import retain_freed_memory

def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

def frame():
    return [np.ones(1 << 20, np.uint8) for _ in range({ARRAYS})]

def work():
    frame()
    before = faults()
    for _ in range({FRAMES}):
        frame()
    print(kept, (faults() - before) // {FRAMES})

kept = 'keep' in sys.argv and retain_freed_memory()
thread = threading.Thread(target=work)
thread.start()
thread.join()
"""


def outcome(*arguments, **variables):
    """Return whether memory is kept, and the page faults of a frame in a thread."""
    environment = {name: value for name, value in os.environ.items()
                   if not name.startswith('MALLOC_') and name != 'GLIBC_TUNABLES'}
    printed = subprocess.run([sys.executable, '-c', PROGRAM, *arguments], text=True, check=True,
                             stdout=subprocess.PIPE, cwd=ROOT, env={**environment, **variables})
    kept, faults = printed.stdout.split()
    return kept == 'True', int(faults)


@pytest.mark.skipif(platform.libc_ver()[0] != 'glibc', reason='only the GNU C library has this')
def test_a_frame_is_processed_without_new_memory_pages():
    kept, faults = outcome('keep')
    assert kept
    assert faults < 10


def test_settings_of_the_user_are_kept():
    assert outcome('keep', MALLOC_ARENA_MAX='2')[0] is False


def test_loaded_objects_are_excluded_from_garbage_collection():
    gc.unfreeze()
    freeze_loaded_objects()
    try:
        assert gc.get_freeze_count() > 10000
        assert len(gc.get_objects()) < 1000
    finally:
        gc.unfreeze()
