# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Work in several processes ends with the main process, however that ends."""

import os
import subprocess
import sys
import time

SCRIPT = """
import multiprocessing, time
from plane_detector.evaluation.benchmark.parallel import mapping
with mapping(2) as apply:
    assert list(apply(abs, [-1, 2, -3])) == [1, 2, 3]
    print(*(child.pid for child in multiprocessing.active_children()), flush=True)
    time.sleep(600)
"""


def is_running(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_processes_end_when_the_first_is_killed():
    with subprocess.Popen([sys.executable, '-c', SCRIPT], stdout=subprocess.PIPE) as first:
        workers = [int(word) for word in first.stdout.readline().split()]
        first.kill()
    assert workers
    end_s = time.monotonic() + 60
    while any(map(is_running, workers)) and time.monotonic() < end_s:
        time.sleep(0.05)
    left = [pid for pid in workers if is_running(pid)]
    for pid in left:
        os.kill(pid, 9)
    assert left == []
