# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Shared code of the subcommands: options, processes, figures; tables below command and commit."""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import platform
import shlex
import subprocess
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import joblib
from tqdm import tqdm

from plane_detector._runtime.process import one_thread, use_one_thread

PROGRAM = 'python3 -m plane_detector.evaluation.benchmark'
HELD_OUT = 9000
"""Scenes from this seed on are for reporting only; they must not be used for tuning."""


def at_least_one(text: str) -> int:
    """Parse an integer argument that must be 1 or more."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f'{number} must be at least 1')
    return number


SHARED: dict[str, dict[str, Any]] = {
    '--data': {'type': Path,
               'default': Path(os.environ.get('PLANE_DETECTOR_DATA', '../shared/data')),
               'help': 'folder of real images, see evaluation/datasets.py; default: '
                       'PLANE_DETECTOR_DATA or %(default)s'},
    '--processes': {'type': at_least_one, 'default': os.cpu_count() or 1},
    '--only-ours': {'action': 'store_true', 'help': 'no other methods'},
    '--scenes': {'type': at_least_one, 'help': 'rendered scenes of each kind'},
    '--rooms': {'type': at_least_one, 'help': 'rooms of boxes'},
    '--living': {'type': at_least_one, 'help': 'lived-in rooms'},
    '--curved': {'type': at_least_one, 'default': 36, 'help': 'curved scenes'},
    '--first-seed': {'type': int, 'default': HELD_OUT,
                     'help': f'of the rendered scenes; those from {HELD_OUT} on were not used for '
                             'tuning'}}


def add_shared(parser: argparse.ArgumentParser, *names: str, **defaults: int) -> None:
    """Declare some of SHARED, some with other defaults."""
    for name in names:
        parser.add_argument(name, **SHARED[name])
    parser.set_defaults(**defaults)


def in_parallel(function: Callable, items: Sequence, processes: int, title: str) -> Iterator:
    """
    Yield what a function returns for each item, in order, from processes of one thread each.

    Function, items and results must be picklable.
    """
    def one(item: Any) -> Any:
        use_one_thread()
        return function(item)

    with one_thread():
        work = joblib.Parallel(processes, return_as='generator', batch_size=1, max_nbytes=None)
        calls = (joblib.delayed(function if processes == 1 else one)(item) for item in items)
        yield from tqdm(work(calls), title, total=len(items), leave=False)


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
    versions = []
    for name in ('numpy', 'scikit-learn', 'onnxruntime', 'pyransac3d'):
        try:
            versions.append(f'{name} {importlib.metadata.version(name)}')
        except importlib.metadata.PackageNotFoundError:
            versions.append(f'{name} not installed')
    return (f'`{PROGRAM} {shlex.join(arguments)}`\n\n{machine()}, OpenCV {cv2.__version__}, '
            f'{", ".join(versions)}; commit {commit()}')


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
    try:
        name, changes = (
            subprocess.run(['git', '-C', str(Path(__file__).resolve().parent), *arguments],
                           capture_output=True, text=True, check=True).stdout.strip()
            for arguments in (('rev-parse', '--short', 'HEAD'),
                              ('status', '--porcelain', '--untracked-files=no')))
    except (OSError, subprocess.CalledProcessError):
        return 'unknown (not a git checkout)'
    return f'{name} with uncommitted changes' if changes else name


def new_figure(size_inches: tuple[float, float]) -> Any:
    """Return an empty figure; ImportError says what to install without matplotlib."""
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError(f'{error}: install the extra, plane_detector[benchmark]') from error
    matplotlib.use('Agg')
    matplotlib.rcParams.update({'svg.hashsalt': 'plane_detector', 'font.size': 9})
    return Figure(figsize=size_inches, layout='constrained')


def save_figure(figure: Any, path: Path) -> Path:
    """Write a figure, without date and random ids: equal samples give equal files."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, metadata={'Date': None})
    return path
