# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Downloads, verified by SHA-256, from the first of several sources that works.

A file is written under a temporary name of its own and renamed when it is whole and right, so that
an interrupted or damaged download never takes the place of the file.
"""

from __future__ import annotations

import contextlib
import hashlib
import http.client
import os
import sys
import time
import urllib.error
import urllib.parse
import urllib.request
import uuid
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from tqdm import tqdm

from plane_detector.stopping import raise_if_stopped

ANSWER_TIMEOUT_S = 5.0
"""A host that sends nothing for this time counts as unreachable."""
SHOW_PROGRESS_AFTER_S = 2.0
_CHUNK_BYTES = 1 << 18
_ABANDONED_S = 3600.0  # a temporary file not written to for this long is of a killed process


class UnreachableError(ConnectionError):
    """A host does not answer, so that asking it for another file would only take time."""


class Source(Protocol):
    """
    A place from which a file is available.

    Attributes
    ----------
    host : str
        Who is asked.

    """

    host: str

    def chunks(self, size_bytes: int) -> Iterable[bytes]:
        """Yield the content of the file, 0: of unknown size; raise OSError if it fails."""

    def by_hand(self, path: Path) -> str:
        """Return instructions for putting the file at ``path`` by hand."""


@dataclass(frozen=True)
class UrlSource:
    """A file at a URL; proxies are taken from the environment."""

    url: str

    @property
    def host(self) -> str:
        """Host of the URL."""
        return urllib.parse.urlsplit(self.url).netloc

    def chunks(self, size_bytes: int) -> Iterator[bytes]:
        """Yield the file's content, with a progress bar if it takes longer; see `Source`."""
        try:
            with urllib.request.urlopen(self.url, timeout=ANSWER_TIMEOUT_S) as response:
                total = size_bytes or int(response.headers.get('Content-Length') or 0)
                with tqdm(desc=self.url.rsplit('/', 1)[-1], total=total or None, unit='B',
                          unit_scale=True, delay=SHOW_PROGRESS_AFTER_S,
                          mininterval=0.2 if sys.stderr.isatty() else 10.0) as bar:
                    while chunk := response.read1(_CHUNK_BYTES):  # `read` would wait for all of it
                        raise_if_stopped()
                        bar.update(len(chunk))
                        yield chunk
        except urllib.error.HTTPError as error:
            raise OSError(f'{self.host} answered {error.code} {error.reason}') from error
        except (OSError, http.client.HTTPException) as error:
            cause = getattr(error, 'reason', error)  # what urllib wraps is easier to understand
            if isinstance(cause, TimeoutError):
                cause = f'no answer within {ANSWER_TIMEOUT_S:g} s'
            raise UnreachableError(f'{self.host} is unreachable ({cause})') from error

    def by_hand(self, path: Path) -> str:
        """Return instructions for putting the file at ``path`` by hand."""
        return f'download {self.url} on another machine and save it as {path}'


def download(sources: Sequence[Source], path: Path, sha256: str, size_bytes: int = 0,
             unreachable: set[str] | None = None) -> None:
    """
    Write a file from the first source that has it.

    Parameters
    ----------
    sources : sequence of Source
        They are tried in turn.
    path : Path
        Path of the file; its folder must exist.
    sha256 : str
        Of the file, 64 hexadecimal digits.
    size_bytes : int
        Of the file; 0: not known.
    unreachable : set of str, optional
        Hosts that are not contacted; those that do not answer are added.

    Raises
    ------
    OSError
        No source works; the message has the reason of each.

    """
    unreachable = set() if unreachable is None else unreachable
    errors = []
    for source in sources:
        if source.host in unreachable:
            errors.append(f'{source.host} was unreachable a moment ago')
            continue
        try:
            _write_verified(path, source.chunks(size_bytes), sha256, size_bytes)
            return
        except OSError as error:
            errors.append(str(error))
            if isinstance(error, UnreachableError):
                unreachable.add(source.host)
    raise OSError('; '.join(errors))


def _write_verified(path: Path, chunks: Iterable[bytes], sha256: str, size_bytes: int) -> None:
    for left in path.parent.glob('.*.part'):
        with contextlib.suppress(OSError):  # another process removed or owns it
            if time.time() - left.stat().st_mtime > _ABANDONED_S:
                left.unlink()
    # Not the process id: containers that share a cache volume often have the same ids.
    temporary = path.with_name(f'.{path.name}.{uuid.uuid4().hex}.part')
    try:
        with open(temporary, 'xb') as file:
            for chunk in chunks:
                file.write(chunk)
                if size_bytes and file.tell() > size_bytes:
                    raise OSError(f'the server sends more than the {size_bytes} bytes of the file')
            file.flush()
            os.fsync(file.fileno())  # otherwise a power failure could leave an empty file
        found = sha256_of(temporary)
        if found != sha256:
            raise OSError(f'the downloaded data has SHA-256 {found} ({temporary.stat().st_size} '
                          f'bytes), not {sha256}: it is incomplete or the file on the server has '
                          'changed')
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file, 64 hexadecimal digits."""
    digest = hashlib.sha256()
    with open(path, 'rb') as file:
        while chunk := file.read(_CHUNK_BYTES):
            digest.update(chunk)
    return digest.hexdigest()
