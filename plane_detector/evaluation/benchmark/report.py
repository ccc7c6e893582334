# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What the subcommands print: Markdown tables, below their command, machine and commit."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import shlex
import subprocess
from collections.abc import Sequence
from pathlib import Path

import cv2

PROGRAM = 'python3 -m plane_detector.evaluation.benchmark'
_PACKAGES = ('numpy', 'scikit-learn', 'onnxruntime', 'pyransac3d')


def table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a Markdown table; numbers are given as text."""
    lines = [header, ['---'] * len(header), *rows]
    return '\n'.join('| ' + ' | '.join(str(cell) for cell in line) + ' |' for line in lines)


def emit(*blocks: str) -> None:
    """Print blocks of Markdown, each followed by an empty line, without delay."""
    for block in blocks:
        print(f'{block}\n', flush=True)


def provenance(arguments: Sequence[str]) -> str:
    """Return the command, the machine, the versions and the commit, as Markdown."""
    versions = ', '.join(f'{name} {_version(name)}' for name in _PACKAGES)
    return (f'`{PROGRAM} {shlex.join(arguments)}`\n\n{machine()}, OpenCV {cv2.__version__}, '
            f'{versions}; commit {commit()}')


def machine() -> str:
    """Return processor, number of cores and version of Python in one line."""
    processor = platform.processor() or platform.machine()
    info = Path('/proc/cpuinfo')
    if info.is_file():
        names = [line.split(':', 1)[1] for line in info.read_text().splitlines()
                 if line.startswith('model name')]
        processor = names[0].strip() if names else processor
    return f'{processor}, {os.cpu_count()} cores, Python {platform.python_version()}'


def commit() -> str:
    """Return the commit of the working tree, and whether there are uncommitted changes."""
    folder = Path(__file__).resolve().parent
    try:
        name, changes = (
            subprocess.run(['git', '-C', str(folder), *arguments], capture_output=True, text=True,
                           check=True).stdout.strip()
            for arguments in (('rev-parse', '--short', 'HEAD'),
                              ('status', '--porcelain', '--untracked-files=no')))
    except (OSError, subprocess.CalledProcessError):
        return 'unknown (not a git checkout)'
    return f'{name} with uncommitted changes' if changes else name


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return 'not installed'
