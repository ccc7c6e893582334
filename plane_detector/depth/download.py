# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Files from the network, whole and verified or not at all.

A file is written under a temporary name of its own, read back, checked against its SHA-256 and
renamed, so that an interrupted, damaged or concurrent download never stands where the real one
would. Size and time of every transfer are bounded. All failures are OSError.
"""

from __future__ import annotations

import glob
import hashlib
import http.client
import os
import queue
import sys
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
import uuid
from collections.abc import Iterable, Iterator
from pathlib import Path

from tqdm import tqdm

from plane_detector.stopping import current_stop, raise_if_stopped

ANSWER_TIMEOUT_S = 5.0
"""A host that does not answer within this time counts as out of reach."""
GRACE_S = 60.0
"""A transfer may be as slow as it likes for this long."""
MIN_BYTES_PER_S = 32_000
"""
After the grace, what has come must have come at this rate on the average, so that a file of n
bytes takes at most ``GRACE_S + n / MIN_BYTES_PER_S``: 53 minutes for 100 MB.
"""
STALE_AFTER_S = 3600.0
"""
A temporary file that nobody wrote to for this long was left by a process that is gone: a living
one writes at least every `ANSWER_TIMEOUT_S`. The rest is for clocks of a shared volume.
"""
SHOW_PROGRESS_AFTER_S = 2.0
_CHUNK_BYTES = 1 << 20
_MOST_BYTES = 1 << 30  # of a file whose size is not known: no server may fill the disk


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
        Required hash of the content.

    Raises
    ------
    OSError
        The content is another one, it broke off, or the folder cannot be written.

    """
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_stale(path)
    # Process ids repeat: containers that share a cache volume often have the same.
    temporary = path.with_name(f'.{path.name}.{uuid.uuid4().hex}.part')
    try:
        size_bytes = _write(temporary, chunks)
        found = sha256_of(temporary)
        if found != sha256:
            raise OSError(f'what came has SHA-256 {found} ({size_bytes} bytes), not {sha256}: '
                          'the download broke off or the file there is another one now')
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _remove_stale(path: Path) -> None:
    """Remove the temporary files that killed downloads of the same file left behind."""
    written_last_s = time.time() - STALE_AFTER_S
    for left in path.parent.glob(f'.{glob.escape(path.name)}.*.part'):
        try:
            if left.stat().st_mtime < written_last_s:
                left.unlink()
        except OSError:  # another process removed it, or owns it: it is in nobody's way
            continue


def _write(path: Path, chunks: Iterable[bytes]) -> int:
    """Write a new file; return its size."""
    size_bytes = 0
    with open(path, 'xb') as file:
        for chunk in chunks:
            file.write(chunk)
            file.flush()  # the time of the last writing tells others that this one is alive
            size_bytes += len(chunk)
        os.fsync(file.fileno())  # a power cut must not leave a renamed but empty file
    return size_bytes


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
        The host is out of reach, has no such file, sends more than it should, or the transfer
        broke off or is slower than `MIN_BYTES_PER_S`.

    """
    host = urllib.parse.urlsplit(url).netloc
    if host in unreachable:
        raise ConnectionError(f'{host} was out of reach a moment ago')
    try:
        with _answer(url) as response:
            total = size_bytes or int(response.headers.get('Content-Length') or 0)
            with _progress(url.rsplit('/', 1)[-1], total) as bar:
                for chunk in _bounded(response, size_bytes or _MOST_BYTES):
                    bar.update(len(chunk))
                    yield chunk
    except urllib.error.HTTPError as error:
        raise OSError(f'{host} answered {error.code} {error.reason}') from error
    except (OSError, http.client.HTTPException) as error:
        unreachable.add(host)
        raise ConnectionError(f'{host} is out of reach ({_cause(error)})') from error


def _bounded(response: http.client.HTTPResponse, most_bytes: int) -> Iterator[bytes]:
    """Yield the data as it arrives; raise if it is too much or too slow."""
    start_s = time.monotonic()
    received_bytes = 0
    while chunk := response.read1(_CHUNK_BYTES):  # `read` waits for all of them
        raise_if_stopped()
        received_bytes += len(chunk)
        if received_bytes > most_bytes:
            raise OSError('it sends more than the file has')
        elapsed_s = time.monotonic() - start_s
        if elapsed_s > GRACE_S + received_bytes / MIN_BYTES_PER_S:
            raise TimeoutError(f'it sent {received_bytes} bytes in {elapsed_s:.0f} s, too slow')
        yield chunk


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
        with current_stop().calling(lambda: answers.put(None)):
            answer = answers.get(timeout=ANSWER_TIMEOUT_S)
    except queue.Empty:
        answer = TimeoutError()
    raise_if_stopped()
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
                delay=SHOW_PROGRESS_AFTER_S, mininterval=0.2 if sys.stderr.isatty() else 10.0)
