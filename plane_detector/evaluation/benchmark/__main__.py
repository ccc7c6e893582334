# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Measure the plane segmentation, beside its peers, and print the tables as Markdown.

    python3 -m plane_detector.evaluation.benchmark > results.md
    python3 -m plane_detector.evaluation.benchmark --only rooms --seeds 5
    python3 -m plane_detector.evaluation.benchmark --only real --data folder --model fastdepth

The sections: `rooms` of boxes, `living` rooms and `curved` things are rendered, with exact truth;
`living_room` is clean depth of a room that others rendered, with labels grown from it (see
evaluation/reference_labels.py), and how little noise changes what is found; `real` pictures have a
sensor's depth. Contact sheets of living rooms and real pictures are written to benchmark_output/.
Peers that are not installed are named as absent.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

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
from plane_detector.evaluation.benchmark.tables import emit, provenance
from plane_detector.evaluation.peers import all_methods

SECTIONS = ('rooms', 'living', 'curved', 'living_room', 'real', 'time')


def parsed() -> argparse.Namespace:
    """Return the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--only', type=_sections, default=SECTIONS, metavar='SECTION,...',
                        help=f'some of {", ".join(SECTIONS)}; default all')
    parser.add_argument('--seeds', type=int, default=20, help='rooms of each set')
    parser.add_argument('--slow-seeds', type=int, default=3,
                        help='rooms of each set for methods that take seconds')
    parser.add_argument('--repeats', type=int, default=15, help='runs of everything timed')
    parser.add_argument('--data', type=Path, default=Path('../shared/data'),
                        help='folder of real pictures, see evaluation/datasets.py')
    parser.add_argument('--model', default='fastdepth', help='network, as depth.model')
    parser.add_argument('--output', type=Path, default=Path('benchmark_output'),
                        help='folder of the contact sheets')
    arguments = parser.parse_args()
    if min(arguments.seeds, arguments.slow_seeds, arguments.repeats) < 1:
        parser.error('--seeds, --slow-seeds and --repeats must be at least 1')
    return arguments


def _sections(text: str) -> tuple[str, ...]:
    wanted = tuple(text.split(','))
    unknown = sorted(set(wanted) - set(SECTIONS))
    if unknown:
        raise argparse.ArgumentTypeError(f'no section {", ".join(unknown)}; there are '
                                         f'{", ".join(SECTIONS)}')
    return wanted


def report(arguments: argparse.Namespace) -> None:
    """Print the sections that were asked for."""
    emit(provenance())
    methods = all_methods()
    if 'rooms' in arguments.only:
        report_rooms(methods, arguments.seeds, arguments.slow_seeds)
        report_misses('Rendered rooms', room, room_sets(arguments.seeds, 0)[1].seeds)
    if 'living' in arguments.only:
        report_living(methods, arguments.seeds, arguments.slow_seeds, arguments.output)
        report_misses('Rendered living rooms', furnished, room_sets(arguments.seeds, 0)[1].seeds)
    if 'curved' in arguments.only:
        report_curved(methods)
    if {'living_room', 'real'} & set(arguments.only):
        found = collect_frames(arguments.data)
        if 'living_room' in arguments.only:
            held_out = held_out_frames(arguments.data)
            report_exact(methods, found, held_out, arguments.output)
            report_consistency(found)
        if 'real' in arguments.only:
            report_real(found, arguments.model, arguments.output)
    if 'time' in arguments.only:
        report_times(methods, arguments.repeats)


def main() -> None:
    """Print the report; what is wrong with the input ends it with a line."""
    try:
        report(parsed())
    except (ValueError, FileNotFoundError) as error:
        sys.exit(f'{error}')


if __name__ == '__main__':
    main()
