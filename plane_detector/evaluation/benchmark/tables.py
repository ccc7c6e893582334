# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What every table of the benchmark needs: where it was made, and Markdown."""

from __future__ import annotations

import importlib.metadata
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from plane_detector.drawing import figure
from plane_detector.evaluation.benchmark.depth_network import machine

_PACKAGES = ('numpy', 'scikit-learn', 'pyransac3d', 'open3d')


def provenance(program: str = 'benchmark') -> str:
    """Return the command, the machine, the versions and the commit, as Markdown."""
    command = ['python3', '-m', f'plane_detector.tools.{program}', *sys.argv[1:]]
    versions = ', '.join(f'{name} {_version(name)}' for name in _PACKAGES)
    return (f'`{shlex.join(command)}`\n\n{machine()}, OpenCV {cv2.__version__}, {versions}; '
            f'commit {commit()}')


def commit() -> str:
    """Return the commit of the working tree, and whether files differ from it."""
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


def table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a Markdown table; numbers are given as text."""
    lines = [header, ['---'] * len(header), *rows]
    return '\n'.join('| ' + ' | '.join(str(cell) for cell in line) + ' |' for line in lines)


def emit(*blocks: str) -> None:
    """Print blocks of Markdown, each followed by an empty line, at once."""
    for block in blocks:
        print(f'{block}\n', flush=True)


def write_sheet(path: Path, panels: Sequence[tuple[str, np.ndarray]], columns: int,
                width_px: int) -> Path:
    """
    Write a contact sheet of titled pictures (H, W, 3) uint8 RGB, each shrunk to one width.

    Returns
    -------
    Path
        Where it is; its folder is made.

    Raises
    ------
    OSError
        It cannot be written.

    """
    path.parent.mkdir(parents=True, exist_ok=True)
    shrunk = [(title, cv2.resize(
        picture, (width_px, round(width_px * picture.shape[0] / picture.shape[1])),
        interpolation=cv2.INTER_AREA)) for title, picture in panels]
    if not cv2.imwrite(str(path), figure(shrunk, columns)[..., ::-1]):
        raise OSError(f'{path} cannot be written')
    return path


def grey_of(rgb: np.ndarray) -> np.ndarray:
    """Return a picture without its colours, (H, W, 3) uint8, to draw planes on."""
    return cv2.cvtColor(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
