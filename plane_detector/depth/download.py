# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Downloads, verified by SHA-256.

A file is written under a unique temporary name, read back, verified and renamed, so that an
interrupted, damaged or concurrent download never takes the place of the file. The size and the
time of every transfer are limited. All failures are OSError.
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
"""A host that does not answer within this time counts as unreachable."""
GRACE_S = 60.0
"""The rate is not checked for this long."""
MIN_BYTES_PER_S = 32_000
"""
After the grace period, the mean rate must be at least this, so that a file of n bytes takes at
most ``GRACE_S + n / MIN_BYTES_PER_S``: 53 minutes for 100 MB.
"""
STALE_AFTER_S = 3600.0
"""
A temporary file not written to for this long belongs to a process that has ended: a running one
writes at least every `ANSWER_TIMEOUT_S`. The rest allows for clock differences on a shared volume.
"""
SHOW_PROGRESS_AFTER_S = 2.0
_CHUNK_BYTES = 1 << 20
_MOST_BYTES = 1 << 30  # of a file of unknown size, so that no server can fill the disk


class _WrongFileError(OSError):
    """The host answers, but the file there is not the one wanted."""


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file, 64 hexadecimal digits."""
    digest = hashlib.sha256()
    with open(path, 'rb') as file:
        while chunk := file.read(_CHUNK_BYTES):
            digest.update(chunk)
    return digest.hexdigest()


def write_verified(path: Path, chunks: Iterable[bytes], sha256: str) -> None:
    """
    Write a file that gets its name only after its SHA-256 is verified.

    Parameters
    ----------
    path : Path
        Path of the file; its folder is created if it does not exist.
    chunks : iterable of bytes
        The content.
    sha256 : str
        Expected hash of the content.

    Raises
    ------
    OSError
        The hash differs, the content is incomplete, or the folder cannot be written.

    """
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_stale(path)
    # Not the process id: containers that share a cache volume often have the same ids.
    temporary = path.with_name(f'.{path.name}.{uuid.uuid4().hex}.part')
    try:
        size_bytes = _write(temporary, chunks)
        found = sha256_of(temporary)
        if found != sha256:
            raise OSError(f'the downloaded data has SHA-256 {found} ({size_bytes} bytes), not '
                          f'{sha256}: it is incomplete or the file on the server has changed')
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _remove_stale(path: Path) -> None:
    """Remove the temporary files of killed downloads of the same file."""
    written_last_s = time.time() - STALE_AFTER_S
    for left in path.parent.glob(f'.{glob.escape(path.name)}.*.part'):
        try:
            if left.stat().st_mtime < written_last_s:
                left.unlink()
        except OSError:  # another process removed or owns it
            continue


def _write(path: Path, chunks: Iterable[bytes]) -> int:
    """Write a new file; return its size."""
    size_bytes = 0
    with open(path, 'xb') as file:
        for chunk in chunks:
            file.write(chunk)
            file.flush()  # updates the modification time, which marks the file as in use
            size_bytes += len(chunk)
        os.fsync(file.fileno())  # otherwise a power failure could leave an empty file
    return size_bytes


def url_chunks(url: str, size_bytes: int, unreachable: set[str]) -> Iterator[bytes]:
    """
    Yield the content of an address; shows a progress bar after two seconds.

    Parameters
    ----------
    url : str
        Address; proxies are taken from the environment.
    size_bytes : int
        Size of the file; more data is an error. 0: not known.
    unreachable : set of str
        Hosts that did not answer before; they are not contacted again. A host is added if it does
        not answer, or sends nothing, for `ANSWER_TIMEOUT_S`.

    Raises
    ------
    OSError
        The host is unreachable, lacks the file or sends too much, or the transfer is interrupted
        or slower than `MIN_BYTES_PER_S`.

    """
    host = urllib.parse.urlsplit(url).netloc
    if host in unreachable:
        raise ConnectionError(f'{host} was unreachable a moment ago')
    received_bytes, most_bytes = 0, size_bytes or _MOST_BYTES
    try:
        with _answer(url) as response:
            total = size_bytes or int(response.headers.get('Content-Length') or 0)
            with _progress(url.rsplit('/', 1)[-1], total) as bar:
                for chunk in _fast_enough(response):
                    bar.update(len(chunk))
                    received_bytes += len(chunk)
                    if received_bytes > most_bytes:
                        raise _WrongFileError(f'{host} sends more than the {most_bytes} bytes '
                                              'that the file has')
                    yield chunk
    except _WrongFileError:
        raise
    except urllib.error.HTTPError as error:
        raise OSError(f'{host} answered {error.code} {error.reason}') from error
    except (OSError, http.client.HTTPException) as error:
        unreachable.add(host)
        raise ConnectionError(f'{host} is unreachable ({_cause(error)})') from error


def _fast_enough(response: http.client.HTTPResponse) -> Iterator[bytes]:
    """Yield the data as it arrives; raise if the rate is too low."""
    start_s, received_bytes = time.monotonic(), 0
    while chunk := response.read1(_CHUNK_BYTES):  # `read` would wait for a full chunk
        raise_if_stopped()
        received_bytes += len(chunk)
        elapsed_s = time.monotonic() - start_s
        if elapsed_s > GRACE_S + received_bytes / MIN_BYTES_PER_S:
            raise TimeoutError(f'it sent {received_bytes} bytes in {elapsed_s:.0f} s, too slow')
        yield chunk


def _answer(url: str) -> http.client.HTTPResponse:
    """Open an address in a thread, because socket timeouts do not limit name resolution."""
    answers: queue.Queue = queue.Queue()

    def ask() -> None:
        try:
            answers.put(urllib.request.urlopen(url, timeout=ANSWER_TIMEOUT_S))
        except (OSError, http.client.HTTPException) as error:  # raised by the caller
            answers.put(error)

    threading.Thread(target=ask, daemon=True).start()
    try:
        with current_stop().calling(lambda: answers.put(None)):
            answer = answers.get(timeout=ANSWER_TIMEOUT_S)
    except queue.Empty:
        answer = TimeoutError()
    raise_if_stopped()
    if isinstance(_cause(answer), TimeoutError):  # from the queue or the socket
        raise TimeoutError(f'no answer within {ANSWER_TIMEOUT_S:g} s')
    if isinstance(answer, Exception):
        raise answer
    return answer


def _cause(error: object) -> object:
    """Return the error that an error of urllib wraps, which is easier to understand."""
    return getattr(error, 'reason', error)


def _progress(label: str, total_bytes: int) -> tqdm:
    """Return a progress bar on stderr; in a log file, a line every ten seconds."""
    return tqdm(desc=label, total=total_bytes or None, unit='B', unit_scale=True,
                delay=SHOW_PROGRESS_AFTER_S, mininterval=0.2 if sys.stderr.isatty() else 10.0)
