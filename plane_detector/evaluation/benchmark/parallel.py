# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Work in several processes with one thread each."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager

from plane_detector.process import one_thread, use_one_thread


@contextmanager
def mapping(processes: int) -> Iterator[Callable]:
    """
    Yield a ``map`` over processes; with one process, over the current one.

    Function, arguments and results must be picklable. The results come in order.
    """
    if processes == 1:
        with one_thread():
            yield map
        return
    # Spawned, not forked: the threads of OpenCV and ONNX Runtime do not survive a fork.
    context = multiprocessing.get_context('spawn')
    with ProcessPoolExecutor(processes, context, _prepare_worker) as pool:
        try:
            yield pool.map
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _prepare_worker() -> None:
    # Ctrl-C is handled by the main process, which ends the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_the_first_process, daemon=True).start()
    use_one_thread()


def _end_with_the_first_process() -> None:
    # If the main process is killed, the others would wait forever.
    multiprocessing.parent_process().join()
    os._exit(1)
