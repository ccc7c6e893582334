# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The process keeps the memory of a frame for the next one, and one thread where asked."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import cv2
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from plane_detector._runtime.process import one_thread

ROOT = Path(__file__).resolve().parents[2]
FRAMES, ARRAYS = 20, 30
PROGRAM = f"""
import resource, sys, threading
import numpy as np
from plane_detector._runtime.process import retain_freed_memory

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

kept = retain_freed_memory(one_heap='thread' in sys.argv)
if 'thread' in sys.argv:
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
else:
    work()
"""


def outcome(*arguments, **variables):
    """Return whether memory is kept, and the page faults of a frame."""
    environment = {name: value for name, value in os.environ.items()
                   if not name.startswith('MALLOC_') and name != 'GLIBC_TUNABLES'}
    printed = subprocess.run([sys.executable, '-c', PROGRAM, *arguments], text=True, check=True,
                             stdout=subprocess.PIPE, cwd=ROOT, env={**environment, **variables})
    kept, faults = printed.stdout.split()
    return kept == 'True', int(faults)


@pytest.mark.parametrize('arguments', [[], ['thread']])
@pytest.mark.skipif(platform.libc_ver()[0] != 'glibc', reason='only the GNU C library has this')
def test_a_frame_is_processed_without_new_memory_pages(arguments):
    kept, faults = outcome(*arguments)
    assert kept
    assert faults < 10


@pytest.mark.parametrize('fails', [False, True])
def test_one_thread_within_as_many_as_before_behind(fails):
    @one_thread()
    def count():
        assert not fails
        return {cv2.getNumThreads(), *thread_counts()}

    def thread_counts():
        return [library['num_threads'] for library in threadpool_info()]

    before = cv2.getNumThreads()
    with threadpool_limits(2):
        counts = thread_counts()  # a library built for one thread keeps to one
        assert 2 in counts
        if fails:
            with pytest.raises(AssertionError):
                count()
        else:
            assert count() == {1}
        assert thread_counts() == counts
    assert cv2.getNumThreads() == before
