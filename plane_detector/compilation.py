# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Loops over cells and pixels, compiled to machine code by numba.

Numba is imported when the first kernel is needed, not with the package. Machine code is kept in
the user's cache, in a folder named by a digest of the sources, so that no code of another version
is ever loaded and the folder of the package may be read-only.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

_KERNELS: list[Kernel] = []
# numba takes its cache folder from a global setting. Two threads that changed it at once would
# write machine code into the working directory.
_COMPILING = threading.Lock()


class Kernel:
    """
    A function that numba compiles at its first call, or when :func:`compile_kernels` is called.

    Parameters
    ----------
    function : callable
        Plain Python that numba understands; it may call other kernels.
    signature : str
        Types of result and arguments in numba's notation; no other types are compiled.

    """

    def __init__(self, function: Callable, signature: str) -> None:
        self._function, self._signature = function, signature
        self._compiled: Callable | None = None
        self.__doc__, self.__name__ = function.__doc__, function.__name__
        self.subject = function.__module__.split('.')[1]
        _KERNELS.append(self)

    @property
    def is_ready(self) -> bool:
        """Whether this process has its machine code already."""
        return self._compiled is not None

    def __call__(self, *arguments: Any) -> Any:
        """Run the machine code."""
        return (self._compiled or self.compiled())(*arguments)

    def compiled(self) -> Callable:
        """Return the function as machine code, from the cache if it is there."""
        with _COMPILING, _one_process(cache_folder()):
            return self.make_ready()

    def make_ready(self) -> Callable:
        """Return the function as machine code; only for who has the folder to itself."""
        if self._compiled is not None:
            return self._compiled
        import numba
        names = self._function.__globals__
        for name in self._function.__code__.co_names:
            callee = names.get(name)
            if isinstance(callee, Kernel):  # numba calls what it compiled itself
                names[name] = callee.make_ready()
        before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(cache_folder())
        try:
            # Sums may be reordered; NaN and infinity keep their meaning.
            self._compiled = numba.njit(
                self._signature, cache=True, nogil=True, error_model='numpy',
                fastmath={'contract', 'reassoc', 'nsz'})(self._function)
        finally:
            numba.config.CACHE_DIR = before
        return self._compiled


def kernel(signature: str) -> Callable[[Callable], Kernel]:
    """Decorate a function to be a :class:`Kernel` of this signature."""
    return lambda function: Kernel(function, signature)


def compile_kernels(subject: str, on_compiling: Callable[[], None] = lambda: None) -> None:
    """
    Compile kernels or load them from the cache: the first frame then takes no longer.

    Parameters
    ----------
    subject : str
        Those of this folder of the package that were imported, as ``'segmentation'``.
    on_compiling : callable
        Called once, after the first kernel that was not in the cache: the others take seconds.

    """
    missing = [one for one in _KERNELS if one.subject == subject and not one.is_ready]
    if not missing:
        return
    is_told = False
    # All in one turn: two processes in turns would each start numba's compiler.
    with _COMPILING, _one_process(cache_folder()):
        for one in missing:
            if one.make_ready().stats.cache_misses and not is_told:
                is_told = True
                on_compiling()


@contextmanager
def _one_process(folder: Path) -> Iterator[None]:
    """Let one process at a time compile: the workers that start with it load its code."""
    with open(folder / 'lock', 'a', encoding='ascii') as file:
        # Windows has no such locks, nor have some network file systems: there each compiles.
        with suppress(ImportError, OSError):
            import fcntl
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


@cache
def cache_folder() -> Path:
    """Return the folder of the machine code; a temporary one if the user has no cache."""
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
