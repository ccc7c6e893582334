# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Segmentation of depth images into planes, by our method and by others.

The sections: `rooms` of boxes, `living` rooms and `curved` surfaces are rendered, with exact
truth. `living_room` is clean depth of a room from another source, with labels grown from it (see
evaluation/reference_labels.py), and the change under slight noise. `real` images have sensor
depth. `time` is run time on one thread. Contact sheets of living rooms and real images are written
to the output folder. Methods that are not installed are listed as absent.
"""

from __future__ import annotations

import argparse

from plane_detector.evaluation.benchmark import options as shared
from plane_detector.evaluation.benchmark.clean_depth import held_out_frames, report_exact
from plane_detector.evaluation.benchmark.curved import report_curved
from plane_detector.evaluation.benchmark.living_rooms import furnished, report_living
from plane_detector.evaluation.benchmark.missed_planes import report_misses
from plane_detector.evaluation.benchmark.real_images import (
    collect_frames,
    report_consistency,
    report_real,
)
from plane_detector.evaluation.benchmark.rooms import report_rooms, room, room_sets
from plane_detector.evaluation.benchmark.runtime import report_times
from plane_detector.evaluation.datasets import frames
from plane_detector.evaluation.peers import all_methods

SECTIONS = ('rooms', 'living', 'curved', 'living_room', 'real', 'time')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('--only', type=_sections, default=SECTIONS, metavar='SECTION,...',
                        help=f'some of {", ".join(SECTIONS)}; default all')
    parser.add_argument('--seeds', type=shared.at_least_one, default=20,
                        help='rooms of each set')
    parser.add_argument('--slow-seeds', type=shared.at_least_one, default=3,
                        help='rooms of each set for methods that take seconds')
    parser.add_argument('--repeats', type=shared.at_least_one, default=15,
                        help='runs of everything timed')
    shared.add_data(parser)
    shared.add_model(parser)
    shared.add_output(parser)


def _sections(text: str) -> tuple[str, ...]:
    wanted = tuple(text.split(','))
    unknown = sorted(set(wanted) - set(SECTIONS))
    if unknown:
        raise argparse.ArgumentTypeError(f'no section {", ".join(unknown)}; there are '
                                         f'{", ".join(SECTIONS)}')
    return wanted


def run(options: argparse.Namespace) -> None:
    """Print the requested sections."""
    methods = all_methods()
    seeds = room_sets(options.seeds, 0)[1].seeds
    if 'rooms' in options.only:
        report_rooms(methods, options.seeds, options.slow_seeds)
        report_misses('Rendered rooms', room, seeds)
    if 'living' in options.only:
        report_living(methods, options.seeds, options.slow_seeds, options.output)
        report_misses('Rendered living rooms', furnished, seeds)
    if 'curved' in options.only:
        report_curved(methods)
    if {'living_room', 'real'} & set(options.only):
        found = collect_frames(options.data)
        if 'living_room' in options.only:
            report_exact(methods, found, held_out_frames(options.data), options.output)
            report_consistency(found)
        if 'real' in options.only:
            report_real(found, options.model, options.output)
    if 'time' in options.only:
        have_data = options.data.is_dir()
        report_times(methods, options.repeats, list(frames(options.data)) if have_data else [])
