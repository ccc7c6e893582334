# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Planes of NYU Depth V2: our method, the paper's method, RANSAC alone and findPlanes.

Each is run on the depth of the sensor and of the network.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from tqdm import tqdm

from plane_detector.evaluation.benchmark import options as shared
from plane_detector.evaluation.benchmark.label_scores import Numbers, summary
from plane_detector.evaluation.benchmark.nyu_frames import (
    ANNOTATIONS,
    METHODS,
    SENSOR,
    FrameResult,
    Task,
    evaluate,
    opened,
)
from plane_detector.evaluation.benchmark.parallel import mapping
from plane_detector.evaluation.benchmark.tables import emit, table
from plane_detector.evaluation.nyu_depth import DEPTHS, read_split

NO_MODEL = 'none'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_nyu(parser)
    parser.add_argument('file', type=Path, help='nyu_depth_v2_labeled.mat')
    parser.add_argument('--methods', type=_methods, default=tuple(METHODS), metavar='NAME,...',
                        help=f'some of {", ".join(METHODS)}; default all')
    parser.add_argument('--model', default='auto',
                        help=f'depth network, as depth.model; {NO_MODEL}: sensor only')
    parser.add_argument('--outside', type=named_folder, action='append', default=[],
                        metavar='NAME=FOLDER', help='label images of another method')
    parser.add_argument('--write-labels', action='store_true',
                        help='write the labels and planes of every method to OUTPUT/labels')
    parser.add_argument('--processes', type=shared.at_least_one, default=os.cpu_count() or 1)
    parser.add_argument('--output', type=Path, default=Path('benchmark_output/nyu'))


def add_nyu(parser: argparse.ArgumentParser) -> None:
    """Add the options that select the frames and the ground truth."""
    parser.add_argument('--split', type=Path, help='splits.mat, or a text file of frame numbers')
    parser.add_argument('--part', choices=('test', 'train'), default='test',
                        help='of splits.mat')
    parser.add_argument('--depth', choices=DEPTHS, default='raw')
    parser.add_argument('--truth', default=ANNOTATIONS,
                        help='annotations: flat parts of annotated instances; sensor: our planes '
                             'in the sensor\'s depth; or a folder of label images')
    parser.add_argument('--worst', type=shared.at_least_one, default=5,
                        help='frames to name for each method')


def _methods(text: str) -> tuple[str, ...]:
    wanted = tuple(text.split(','))
    if not set(wanted) <= set(METHODS):
        raise argparse.ArgumentTypeError(f'{text}: there are {", ".join(METHODS)}')
    return wanted


def named_folder(text: str) -> tuple[str, Path]:
    """Split NAME=FOLDER."""
    name, _, folder = text.partition('=')
    if not (name and folder):
        raise argparse.ArgumentTypeError(f'{text} must be NAME=FOLDER')
    return name, Path(folder).resolve()


def run(options: argparse.Namespace) -> None:
    """Evaluate the frames, print the tables."""
    write_to = (options.output / 'labels').resolve() if options.write_labels else None
    task = Task(options.file.resolve(), options.depth, resolved(options.truth), options.methods,
                '' if options.model == NO_MODEL else options.model, tuple(options.outside),
                write_to)
    numbers = chosen_frames(task.path, options.split, options.part)
    results = evaluate_all(task, numbers, options.processes)
    for name in task.methods:
        if METHODS[name]().absent:
            emit(f'{name}: absent, {METHODS[name]().absent}.')
    report(f'NYU Depth V2, {len(results)} frames, {task.depth} depth, truth: {options.truth}',
           results, options.worst)
    if task.truth == SENSOR:
        emit('The truth is our own result on the sensor\'s depth: the row of that method and '
             'source says nothing, and the other rows favour our method.')


def resolved(truth: str) -> str:
    """Return a truth that is a folder as an absolute path, so that all processes find it."""
    return str(Path(truth).resolve()) if Path(truth).is_dir() else truth


def chosen_frames(path: Path, split: Path | None, part: str) -> Sequence[int]:
    """Return the frame numbers of a split; all frames without one."""
    count = len(opened(path))
    numbers = read_split(split, part) if split else range(1, count + 1)
    if not 1 <= min(numbers) <= max(numbers) <= count:
        raise ValueError(f'{split} names frames that {path} does not have; it has {count}')
    return numbers


def evaluate_all(task: Task, numbers: Sequence[int], processes: int) -> list[FrameResult]:
    """Evaluate frames in several processes."""
    with mapping(processes) as apply:
        return list(tqdm(apply(partial(evaluate, task), numbers), 'frames', total=len(numbers)))


def report(title: str, results: Sequence[FrameResult], worst: int) -> None:
    """Print all tables."""
    rows = by_row(results)
    emit(f'### {title}', *summary(rows, worst))
    cpu_ms = {name: [result.cpu_ms[name] for result in results
                     if np.isfinite(result.cpu_ms.get(name, np.nan))] for name in rows}
    times = [[name, f'{np.median(taken):.1f}', f'{np.max(taken):.1f}']
             for name, taken in cpu_ms.items() if taken]
    if times:
        emit(table(('method', 'CPU ms, median', 'worst'), times))


def by_row(results: Sequence[FrameResult]) -> dict[str, dict[int, Numbers]]:
    """Return the metrics by name of the row, then by frame."""
    rows: dict[str, dict[int, Numbers]] = {}
    for result in results:
        for name, numbers in result.rows.items():
            rows.setdefault(name, {})[result.number] = numbers
    return rows
