# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Evaluation of label images of any method on NYU Depth V2, like ours.

evaluation/label_folder.py describes the format of the folder.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from plane_detector.evaluation.benchmark import options as shared
from plane_detector.evaluation.benchmark.nyu import (
    add_nyu,
    chosen_frames,
    evaluate_all,
    named_folder,
    report,
    resolved,
)
from plane_detector.evaluation.benchmark.nyu_frames import Task
from plane_detector.evaluation.benchmark.tables import emit
from plane_detector.evaluation.label_folder import label_files, read_plane_table


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('folder', type=_folder, nargs='+',
                        help='of label images, or NAME=FOLDER')
    parser.add_argument('--nyu', type=Path, required=True, metavar='FILE',
                        help='nyu_depth_v2_labeled.mat')
    add_nyu(parser)
    parser.add_argument('--processes', type=shared.at_least_one, default=os.cpu_count() or 1)


def _folder(text: str) -> tuple[str, Path]:
    return named_folder(text if '=' in text else f'{Path(text).resolve().name}={text}')


def run(options: argparse.Namespace) -> None:
    """Score the frames available in the folders and print the tables."""
    folders = tuple(options.folder)
    task = Task(options.nyu.resolve(), options.depth, resolved(options.truth), methods=(),
                outside=folders)
    given = set().union(*(label_files(folder) for _, folder in folders))
    numbers = [number for number in chosen_frames(task.path, options.split, options.part)
               if number in given]
    if not numbers:
        raise ValueError('no label image has the number of a frame that counts')
    results = evaluate_all(task, numbers, options.processes)
    report(f'NYU Depth V2, {len(numbers)} frames, {task.depth} depth, truth: {options.truth}',
           results, options.worst)
    for name, folder in folders:
        if not read_plane_table(folder):
            emit(f'{name} has no CSV of planes: they are fitted to the sensor\'s depth, so its '
                 'errors and its recall over depth and normals flatter it.')
