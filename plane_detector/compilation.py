# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Loops over cells and pixels, compiled to machine code by numba.

Numba is imported when the first kernel is needed, not with the package. The machine code is cached
in a user folder named by a digest of the sources, so that code of another version is never loaded
and the folder of the package may be read-only.
"""

from __future__ import annotations

import gc
import hashlib
import logging
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

_KERNELS: list[Kernel] = []
# Numba takes its cache folder from a global setting, so only one thread may change it at a time;
# otherwise machine code would be written to the working directory.
_COMPILING = threading.Lock()


class Kernel:
    """
    A function that numba compiles at its first call or in :func:`compile_kernels`.

    Parameters
    ----------
    function : callable
        Python function within numba's subset of the language; it may call other kernels.
    signature : str
        Types of result and arguments in numba's notation; no other types are compiled.
    is_short : bool
        It keeps the interpreter's lock. A stage that gives it away for less than the switch
        interval waits longer to get it back than the loop takes; with some fifty such loops in a
        frame, the stages of the node took a fifth more core time and twice the time. True for
        loops over cells or planes: the longest ends in a quarter of the node's switch interval.

    """

    def __init__(self, function: Callable, signature: str, is_short: bool = False) -> None:
        self._function, self._signature, self._is_short = function, signature, is_short
        self._compiled: Callable | None = None
        self.__doc__, self.__name__ = function.__doc__, function.__name__
        self.__module__ = function.__module__
        self.subject = function.__module__.split('.')[1]
        _KERNELS.append(self)

    @property
    def is_ready(self) -> bool:
        """Whether its machine code is loaded in this process."""
        return self._compiled is not None

    def __call__(self, *arguments: Any) -> Any:
        """Run the machine code."""
        return (self._compiled or self.compiled())(*arguments)

    def compiled(self) -> Callable:
        """Return the compiled function, loaded from the cache if possible."""
        with _COMPILING, _one_process(cache_folder()):
            return self.make_ready()

    def make_ready(self) -> Callable:
        """Return the compiled function; the caller must hold the locks, see `compiled`."""
        if self._compiled is not None:
            return self._compiled
        import numba
        names = self._function.__globals__
        for name in self._function.__code__.co_names:
            callee = names.get(name)
            if isinstance(callee, Kernel):  # numba calls what it compiled itself
                names[name] = callee.make_ready()
        before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(cache_folder())
        collects = gc.isenabled()
        gc.disable()  # a sixth of the time to compile would go into looking for garbage
        try:
            # Sums may be reordered; NaN and infinity are still handled exactly.
            self._compiled = numba.njit(
                self._signature, cache=True, nogil=not self._is_short, error_model='numpy',
                no_cfunc_wrapper=True, fastmath={'contract', 'reassoc', 'nsz'})(self._function)
        finally:
            numba.config.CACHE_DIR = before
            if collects:
                gc.enable()
        return self._compiled


def kernel(signature: str, is_short: bool = False) -> Callable[[Callable], Kernel]:
    """Turn a function into a :class:`Kernel` with these properties."""
    return lambda function: Kernel(function, signature, is_short)


def are_ready(subject: str) -> bool:
    """Return whether the machine code of all imported kernels of a folder is loaded."""
    return all(one.is_ready for one in _KERNELS if one.subject == subject)


def compile_kernels(subjects: Iterable[str],
                    on_compiling: Callable[[], None] = lambda: None) -> None:
    """
    Compile kernels, or load them from the cache, so that the first frame is not delayed.

    A second process compiles too, starting with the last kernel; this one loads its results.

    Parameters
    ----------
    subjects : iterable of str
        Folders of the package, such as ``'segmentation'``; their imported kernels are compiled.
    on_compiling : callable
        Called once, after the first kernel that was not cached; the others then take seconds.

    """
    missing = [one for subject in subjects for one in _KERNELS
               if one.subject == subject and not one.is_ready]
    if not missing:
        return
    is_reported = False
    # Under one lock: processes that take turns would each start numba's compiler.
    with _COMPILING, _one_process(cache_folder()), ExitStack() as helpers:
        for one in missing:
            if one.make_ready().stats.cache_misses and not is_reported:
                is_reported = True
                on_compiling()
                helpers.callback(_end, _second_process(missing))


@contextmanager
def _one_process(folder: Path) -> Iterator[None]:
    """Let one process at a time compile; workers started with it load its machine code."""
    with open(folder / 'lock', 'a', encoding='ascii') as file:
        # Without such locks, as on Windows and some network file systems, each process compiles.
        with suppress(ImportError, OSError):
            import fcntl
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


@cache
def load_once(*subjects: str) -> None:
    """Compile or load the kernels of these folders, at the first call of a process only."""
    compile_kernels(subjects, lambda: logging.getLogger(__name__).warning(
        'compiling the loops for this machine, once'))


def _second_process(wanted: list[Kernel]) -> subprocess.Popen | None:
    """Start a process that compiles the kernels, last one first, if there is a core for it."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else 1
    if cores < 2 or not sys.executable:
        return None
    code = 'from plane_detector import compilation; compilation.compile_backwards()'
    names = [f'{one.__module__}:{one.__name__}' for one in wanted]
    # A session of its own: a signal to end is for this process, which ends the other one.
    return subprocess.Popen(
        [sys.executable, '-c', code, str(os.getpid()), *names], start_new_session=True,
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)}, stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _end(process: subprocess.Popen | None) -> None:
    if process is not None:
        process.kill()
        process.wait()


def compile_backwards() -> None:
    """
    Compile the kernels named on the command line, last one first, while the parent lives.

    The parent holds the lock.
    """
    parent, names = int(sys.argv[1]), sys.argv[2:]
    for name in reversed(names):
        if os.getppid() != parent:
            return
        module, _, function = name.partition(':')
        import_module(module)
        for one in _KERNELS:
            if (one.__module__, one.__name__) == (module, function):
                one.make_ready()


@cache
def cache_folder() -> Path:
    """Return the folder of the machine code; a temporary one if the user cache is not writable."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob('*.py')):
        source = path.read_bytes()
        if b'compilation import kernel' in source:
            digest.update(source)
    root = Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache')
    folder = root / 'plane_detector' / f'kernels-{digest.hexdigest()[:12]}'
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError:
        folder = Path(tempfile.gettempdir()) / f'plane_detector-{os.getuid()}' / folder.name
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    return folder
