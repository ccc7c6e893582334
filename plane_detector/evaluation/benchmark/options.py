# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Options shared by several subcommands of the benchmark."""

from __future__ import annotations

import argparse
import os
from pathlib import Path


def at_least_one(text: str) -> int:
    """Parse an integer argument that must be 1 or more."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f'{number} must be at least 1')
    return number


def add_data(parser: argparse.ArgumentParser) -> None:
    """Add the folder of real images."""
    parser.add_argument('--data', type=Path,
                        default=Path(os.environ.get('PLANE_DETECTOR_DATA', '../shared/data')),
                        help='folder of real images, see evaluation/datasets.py; default: '
                             'PLANE_DETECTOR_DATA or %(default)s')


def add_scenes(parser: argparse.ArgumentParser, rooms: int, living: int, first_seed: int) -> None:
    """Add the numbers of rendered scenes, see :func:`scene_counts`, and their seed."""
    parser.add_argument('--rooms', type=at_least_one, default=rooms, help='rooms of boxes')
    parser.add_argument('--living', type=at_least_one, default=living, help='lived-in rooms')
    parser.add_argument('--curved', type=at_least_one, default=36, help='curved scenes')
    parser.add_argument('--first-seed', type=int, default=first_seed)


def scene_counts(options: argparse.Namespace) -> dict[str, int]:
    """Return the number of scenes of each kind, as :func:`samples.plan` takes it."""
    return {'rooms': options.rooms, 'lived-in rooms': options.living, 'curved': options.curved}


def add_model(parser: argparse.ArgumentParser) -> None:
    """Add the depth network."""
    parser.add_argument('--model', default='fastdepth', help='network, as depth.model')
