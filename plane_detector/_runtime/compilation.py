# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Kernels: loops over cells and pixels, compiled to machine code by numba.

Numba is imported when the first kernel is needed, not with the package. The machine code is cached
in a folder of the user. The folder of each kernel is named by a digest of everything that numba
compiles into it: its file, the values of the constants that it uses, also of other files, and the
kernels that it calls. (Numba itself would notice only a change of the file.)

Compiling is slow, mostly in Python, and numba compiles one function at a time. It is therefore
done by as many processes as there are cores; this process stays responsive and loads the results.
A kernel with a single caller becomes part of that caller before types are inferred, which saves an
eighth of the core time: LLVM would optimise and emit it once separately and once in each caller.
"""

from __future__ import annotations

import dis
import gc
import hashlib
import logging
import os
import re
import shutil
import stat
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, cached_property
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from types import FunctionType
from typing import Any

from plane_detector._runtime.stopping import raise_if_stopped

# chosen: more processes need 150 MB each and wait for the longest kernel anyway.
MOST_PROCESSES = 6
LOG_PERIOD_S = 5.0
"""Time between two messages while kernels are compiled."""
_CHECK_S = 0.1
_PYTHON_NAME = re.compile(r'(python|pypy)[\d.]*t?')
# chosen: longer than a robot rests; each change of a file leaves the old folders behind.
_UNUSED_S = 30 * 24 * 3600.0
# The program of a helper. In isolated mode the working directory is not searched for modules.
_HELPER = """
import os, sys
sys.path[:] = sys.argv[1].split(os.pathsep)
from plane_detector._runtime.compilation import help_parent
help_parent(int(sys.argv[2]), set(sys.argv[3].split()), sys.argv[4:])
"""
_KERNELS: list[Kernel] = []
# Numba takes its cache folder from a global setting, so only one thread may change it at a time;
# otherwise machine code would be written to the working directory.
_COMPILING = threading.Lock()
_memory_only = threading.Event()  # set when the cache folder cannot be written


class Kernel:
    """
    A function that numba compiles at its first call or in :func:`compile_kernels`.

    Parameters
    ----------
    function : callable
        Python function within numba's subset of the language; it may call kernels defined before.
    signature : str
        Types of result and arguments in numba's notation; no other types are compiled.
    is_short : bool
        It keeps the interpreter lock. A stage that releases the lock for less than the switch
        interval waits longer to get it back than the kernel runs; with some fifty such kernels per
        frame, the stages of the node took a fifth more core time and twice the elapsed time. True
        for loops over cells or planes: the longest ends within a quarter of the node's switch
        interval.
    subject : str
        Name for :func:`compile_kernels`; by default the folder of its module.

    """

    def __init__(self, function: Callable, signature: str, is_short: bool = False,
                 subject: str = '') -> None:
        self._function, self._signature, self._is_short = function, signature, is_short
        self._compiled: Callable | None = None
        self.__doc__, self.__name__ = function.__doc__, function.__name__
        self.__module__ = function.__module__
        self.subject = subject or function.__module__.split('.')[1]
        _KERNELS.append(self)

    def __call__(self, *arguments: Any) -> Any:
        """Run the machine code."""
        return (self._compiled or self.compiled())(*arguments)

    @property
    def is_ready(self) -> bool:
        """Whether its machine code is loaded in this process."""
        return self._compiled is not None

    @property
    def is_cached(self) -> bool:
        """Whether another process has compiled it."""
        # Numba writes the index (nbi) first.
        folder = _folder_of(self)
        return folder is not None and any(folder.glob('*/*.nbc'))

    @cached_property
    def digest(self) -> str:
        """Name of its cache folder."""
        digest = _digest_of_file(self._function.__code__.co_filename).copy()
        digest.update(f'{self.__name__}\n'.encode())
        for name in self._function.__code__.co_names:
            value = self._function.__globals__.get(name)
            if isinstance(value, Kernel):
                value = value.digest
            elif hasattr(value, 'tolist'):  # a numpy array or number
                value = value.dtype, value.tolist()
            if isinstance(value, (bool, int, float, str, tuple)):
                digest.update(f'{name} {value!r}\n'.encode())
        return digest.hexdigest()[:12]

    def compiled(self) -> Callable:
        """Return the compiled function, loaded from the cache if possible."""
        if self._compiled is None:
            with _COMPILING:
                self._compile()
        return self._compiled

    def _compile(self) -> None:
        """Compile or load; the caller must hold the lock."""
        if self._compiled is not None:
            return
        import numba
        if self.is_cached:  # machine code contains its callees, which are half of all kernels
            with suppress(numba.core.errors.TypingError):  # it is for another processor
                self._compiled = self._jit(self._function)
                return
        self._compiled = self._jit(self._with_callees())

    def _with_callees(self) -> FunctionType:
        """Return its function with callees that numba can call; the caller must hold the lock."""
        import numba
        code, names = self._function.__code__, dict(self._function.__globals__)
        for name in code.co_names:
            if not isinstance(callee := names.get(name), Kernel):
                continue
            if callee._is_called_once:
                names[name] = numba.njit(inline='always')(callee._with_callees())
            else:
                callee._compile()
                names[name] = callee._compiled
        function = FunctionType(code, names, self.__name__)
        function.__module__ = self.__module__
        return function

    @property
    def _is_called_once(self) -> bool:
        """Whether its module, which alone may use a private name, calls it at only one place."""
        return self.__name__.startswith('_') and sum(
            step.argval == self.__name__ for one in _KERNELS if one.__module__ == self.__module__
            for step in dis.get_instructions(one._function.__code__)) == 1

    def _jit(self, function: Callable) -> Callable:
        collects = gc.isenabled()
        gc.disable()  # garbage collection would take a sixth of the compile time
        try:
            try:
                return self._jit_in(_folder_of(self), function)
            except OSError as error:
                _keep_in_memory(error)
            return self._jit_in(None, function)
        finally:
            if collects:
                gc.enable()

    def _jit_in(self, folder: Path | None, function: Callable) -> Callable:
        """Compile a function, or load it from its folder; the caller must hold the lock."""
        import numba
        before = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = before if folder is None else str(folder)
        try:
            # Sums may be reordered; NaN and infinity are still handled exactly.
            return numba.njit(
                self._signature, cache=folder is not None, nogil=not self._is_short,
                error_model='numpy', no_cfunc_wrapper=True,
                fastmath={'contract', 'reassoc', 'nsz'})(function)
        finally:
            numba.config.CACHE_DIR = before


def kernel(signature: str, is_short: bool = False,
           subject: str = '') -> Callable[[Callable], Kernel]:
    """Turn a function into a :class:`Kernel` with these properties."""
    return lambda function: Kernel(function, signature, is_short, subject)


def are_ready(subject: str) -> bool:
    """Return whether the machine code of all imported kernels of a subject is loaded."""
    return all(one.is_ready for one in _own_kernels({subject}))


def _own_kernels(subjects: set[str]) -> list[Kernel]:
    """Return the kernels that no other kernel calls; their machine code contains the others."""
    called = {value for one in _KERNELS for name in one._function.__code__.co_names
              if isinstance(value := one._function.__globals__.get(name), Kernel)}
    return [one for one in _KERNELS if one.subject in subjects and one not in called]


def compile_kernels(subjects: Iterable[str], log: Callable[[str], None] = lambda text: None,
                    what: str = 'the kernels') -> None:
    """
    Compile kernels, or load the top-level ones, so that the first frame is not delayed.

    Parameters
    ----------
    subjects : iterable of str
        Folders of the package, such as ``'segmentation'``, or ``'network'`` for kernels that only
        the depth of a network needs. Their imported kernels are compiled.
    log : callable
        Called with a text when kernels must be compiled, and every five seconds while they are.
    what : str
        Name of what is compiled, for this text.

    """
    subjects = set(subjects)
    wanted = [one for one in _own_kernels(subjects) if not one.is_ready]
    if not wanted:
        return
    with _one_process(wanted[0]):
        missing = [one for one in wanted if not one.is_cached]
        if missing:
            log(f'compiling {what} for this machine, once; this takes up to a minute')
            if not _memory_only.is_set():
                try:
                    _compile_in_processes(missing, log, what)
                except OSError as error:
                    log(f'no process can be started to help: {error}')
        for one in wanted:
            one.compiled()
    _remove_unused(wanted)


def free_intermediate_code() -> None:
    """
    Free the code from which numba would link loaded kernels into others, where none calls them.

    It is two thirds of the memory of the kernels. Numba has no public name for it; should the
    private one change, the memory stays. Only for programs that have imported all kernels: one
    that is imported later, and calls a kernel that none called before, cannot be compiled.
    """
    for one in _own_kernels({one.subject for one in _KERNELS}):
        for overload in one._compiled.overloads.values() if one.is_ready else ():
            overload.library._shared_module = None


@cache
def load_once(*subjects: str) -> None:
    """Compile or load the kernels of these subjects, only at the first call in a process."""
    compile_kernels(subjects, logging.getLogger(__name__).warning)


def _python() -> str | None:
    """
    Return the program that runs this version of Python; None if there is none.

    In a program that embeds Python, ``sys.executable`` is that program, or empty; it must not be
    started as a helper.
    """
    name = f'python{sys.version_info.major}.{sys.version_info.minor}'
    folders = [Path(prefix) / 'bin' for prefix in (sys.prefix, sys.base_prefix)]
    for program in (Path(sys.executable or os.devnull), *(folder / name for folder in folders)):
        if _PYTHON_NAME.fullmatch(program.name) and os.access(program, os.X_OK):
            return str(program)
    return None


def _compile_in_processes(kernels: list[Kernel], log: Callable[[str], None],
                          what: str) -> None:
    """
    Let other processes fill the cache; the caller compiles whatever they fail to compile.

    Processes of multiprocessing would rerun a user's program that calls this package outside ``if
    __name__ == '__main__'``, and search the working directory for modules.
    """
    if (python := _python()) is None:
        log(f'{sys.executable or "this program"} is not Python and none is in {sys.prefix}: no '
            'process can help, so that compiling takes several times as long')
        return
    # One module at a time, because its kernels share callees; the longest first, to end together.
    length = Counter()
    for one in _KERNELS:
        length[one.__module__] += len(one._function.__code__.co_code)
    modules = sorted({one.__module__ for one in kernels}, key=length.get, reverse=True)
    # Each helper reads the number of its next module from the same pipe.
    queue, end = os.pipe()
    os.write(end, bytes(range(len(modules))))
    os.close(end)
    # This package first, from wherever the calling program has imported it.
    search_path = os.pathsep.join([str(Path(__file__).parents[2]), *filter(None, sys.path)])
    command = [python, '-I', *(['-B'] if sys.dont_write_bytecode else []), '-c', _HELPER,
               search_path, str(os.getpid()), ' '.join({one.subject for one in kernels}), *modules]
    # Numba would add colour markup to each of the 50000 types that it tries in vain.
    environment = {**os.environ, 'NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING': '1'}
    helpers, logged_s = [], time.monotonic()
    with open(queue, 'rb') as numbers, tempfile.TemporaryFile() as errors:
        try:
            for _ in range(min(len(os.sched_getaffinity(0)), MOST_PROCESSES, len(modules))):
                # A separate session: a signal to end is meant for this process, which ends the
                # others.
                helpers.append(subprocess.Popen(
                    command, stdin=numbers, stdout=subprocess.DEVNULL, stderr=errors,
                    env=environment, start_new_session=True))
            while any(helper.poll() is None for helper in helpers):
                raise_if_stopped()
                if time.monotonic() - logged_s > LOG_PERIOD_S:
                    logged_s, done = time.monotonic(), [one for one in kernels if one.is_cached]
                    log(f'{what}: {len(done)} of {len(kernels)} compiled')
                    for one in done:  # loading all of them at the end would take a second or two
                        one.compiled()
                time.sleep(_CHECK_S)
        finally:
            for helper in helpers:
                helper.kill()
                helper.wait()
        if any(helper.returncode for helper in helpers):
            errors.seek(0)
            reason = errors.read().decode(errors='replace').strip().rpartition('\n')[2]
            log(f'a helper process has failed, so compiling takes longer: {reason}')


def help_parent(parent: int, subjects: set[str], modules: Sequence[str]) -> None:
    """
    Compile kernels of subjects while the parent process is alive.

    The numbers of their modules are read from standard input.
    """
    for module in modules:
        import_module(module)
    own = _own_kernels(subjects)
    while number := os.read(0, 1):
        for one in own:
            if os.getppid() != parent:
                return
            if one.__module__ == modules[number[0]]:
                one.compiled()


@contextmanager
def _one_process(one: Kernel) -> Iterator[None]:
    """Let only one process compile at a time; other workers load its machine code."""
    with ExitStack() as held:
        if (folder := _folder_of(one)) is not None:
            try:
                folder.mkdir(exist_ok=True)
                file = held.enter_context(open(folder / 'lock', 'a', encoding='ascii'))
            except OSError as error:
                _keep_in_memory(error)
            else:
                # Without such locks, as on Windows and some network file systems, each process
                # compiles.
                with suppress(ImportError, OSError):
                    import fcntl
                    fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _folder_of(one: Kernel) -> Path | None:
    """Return the folder of the machine code of a kernel; None if it is kept only in memory."""
    if _memory_only.is_set():
        return None
    try:
        return cache_folder() / one.digest
    except OSError as error:
        _keep_in_memory(error)
        return None


def _keep_in_memory(error: OSError) -> None:
    """Keep machine code only in memory from now on."""
    if not _memory_only.is_set():
        _memory_only.set()
        logging.getLogger(__name__).warning(
            '%s cannot be written (%s): the kernels stay in memory and are compiled again at each '
            'start', _home_folder(), error.strerror or error)


def _remove_unused(used: Iterable[Kernel]) -> None:
    """Remove the folders of machine code that no process has used for a month."""
    with suppress(OSError):
        for folder in filter(None, map(_folder_of, used)):
            os.utime(folder)
        for folder in cache_folder().iterdir() if not _memory_only.is_set() else ():
            if time.time() - folder.stat().st_mtime > _UNUSED_S:
                shutil.rmtree(folder, ignore_errors=True)


@cache
def _digest_of_file(path: str) -> Any:
    # Numba compiles again if its version, Python's, or the path or time of the file has changed.
    versions = f'{version("numba")} {sys.version} {path} {os.stat(path).st_mtime_ns}\n'
    return hashlib.sha256(versions.encode() + Path(path).read_bytes())


@cache
def cache_folder() -> Path:
    """
    Return the folder of the machine code, to which no other user can write.

    Numba unpickles the files that it finds there. If neither the user's cache nor a folder of the
    user in the temporary directory is usable, the folder is a new one, and each start compiles
    again.
    """
    folders = [_home_folder()]
    with suppress(OSError):  # on a full disk there is no temporary directory
        folders.append(Path(tempfile.gettempdir()) / f'plane_detector-{os.getuid()}')
    for folder in folders:
        with suppress(OSError):
            folder.parent.mkdir(parents=True, exist_ok=True)
            folder.mkdir(exist_ok=True, mode=0o700)
            if _is_ours_alone(folder) and _only_we_rename_in(folder.parent):
                return folder
    folder = Path(tempfile.mkdtemp(prefix='plane_detector-'))
    logging.getLogger(__name__).warning(
        '%s belongs to another user or others may write to it: the kernels are compiled again at '
        'each start', folders[-1])
    return folder


def _home_folder() -> Path:
    home = os.environ.get('XDG_CACHE_HOME') or Path('~/.cache').expanduser()
    return Path(home) / 'plane_detector' / 'kernels'


def _is_ours_alone(folder: Path) -> bool:
    """Return whether the folder is not a link, and only this user owns it and writes to it."""
    status = folder.lstat()
    return (stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid()
            and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
            and os.access(folder, os.W_OK | os.X_OK))


def _only_we_rename_in(folder: Path) -> bool:
    """Return whether no other user can replace a folder inside this folder."""
    status = folder.stat()
    others = stat.S_IWOTH | (stat.S_IWGRP if status.st_gid != os.getgid() else 0)
    return (status.st_uid in (0, os.getuid())
            and bool(status.st_mode & stat.S_ISVTX or not status.st_mode & others))
