# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Accuracy and time on all kinds of scenes, in one run of a few minutes.

Rendered rooms of boxes, lived-in rooms and curved surfaces, with our method and others, on seeds
that were not used for tuning. --plots also draws the same numbers.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import numpy as np

from plane_detector.evaluation.benchmark.options import add_shared
from plane_detector.evaluation.benchmark.report import emit, table
from plane_detector.evaluation.benchmark.samples import (
    COUNTS,
    Noise,
    Sample,
    plan,
    run_jobs,
)
from plane_detector.evaluation.metrics import MIN_PIXELS, known_mean
from plane_detector.evaluation.peers import Ours, all_methods
from plane_detector.evaluation.scenes.sensors import SENSORS

EXACT_TRUTH, CURVED = ('rooms', 'lived-in rooms'), 'curved'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_shared(parser, *COUNTS, '--first-seed', '--only-ours', '--processes', rooms=20, living=16)
    parser.add_argument('--slow', type=int, default=5,
                        help='rooms of each kind for methods that take seconds')
    only = parser.add_mutually_exclusive_group()
    only.add_argument('--sensors', action='store_true', help='only simulated sensors')
    only.add_argument('--rendered', action='store_true', help='no simulated sensors')
    parser.add_argument('--plots', type=Path, metavar='FOLDER', help='write accuracy.svg there')


def run(options: argparse.Namespace) -> None:
    """Print the tables, and write the figure if requested."""
    methods = [Ours()] if options.only_ours else all_methods()
    jobs = plan(methods, vars(options), options.first_seed, options.slow,
                rendered=not options.sensors,
                sensors=() if options.rendered else tuple(SENSORS))
    samples = run_jobs(jobs, options.processes)
    report(samples)
    emit(*(f'{method.name}: absent, {method.absent}.' for method in methods if method.absent))
    if options.plots:
        from plane_detector.evaluation.benchmark.plots import write_figure
        emit(f'Figure: `{write_figure(samples, options.plots)}`')


def report(samples: Sequence[Sample]) -> None:
    """Print the comparison of all methods, then details of ours and of curved scenes."""
    for kind in EXACT_TRUTH:
        own = [one for one in samples if one.kind == kind]
        if own:
            title = f'### {kind[0].upper()}{kind[1:]}: SC / recall / precision by'
            for by, is_sensor in (('noise (1/m)', False), ('simulated sensor', True)):
                seen = [one for one in own if isinstance(one.noise, str) is is_sensor]
                if seen:
                    emit(f'{title} {by}', comparison(seen))
    groups = grouped(samples)
    first = samples[0].method if samples else ''
    for title, header, cells, wanted in (
            (f'{first} in detail', ('SC', 'worst SC (seed)', 'recall', 'precision', 'unlabelled'),
             _exact_cells, lambda kind, method: kind in EXACT_TRUTH and method == first),
            ('Columns, pipes and balls',
             ('taken for planes', 'worst', 'least IoU of a plane'), _curved_cells,
             lambda kind, _: kind == CURVED)):
        rows = [[kind, noise_text(noise), method, str(len(group)), *cells(group), *_times(group)]
                for (kind, noise, method), group in groups.items() if wanted(kind, method)]
        if rows:
            emit(f'### {title}', table(('scenes', 'noise (1/m)', 'method', 'n', *header,
                                        'CPU ms, median', 'worst'), rows))
    emit(f'Recall: true planes over {MIN_PIXELS} pixels that a predicted one matches with '
         'IoU > 0.5; precision: predicted planes that match. Unlabelled: share of the pixels on '
         'true planes without a label. Taken for planes: share of the curved pixels that got a '
         'label. Times are of one core, from depth to labels and planes.')


def comparison(samples: Sequence[Sample]) -> str:
    """Return a Markdown table with a row for each method and a column for each noise."""
    groups = grouped(samples)
    noises = list(dict.fromkeys(one.noise for one in samples))
    lines = []
    for method in dict.fromkeys(one.method for one in samples):
        own = [group for (_, _, name), group in groups.items() if name == method]
        lines.append([method, str(len(own[0])), *(
            means(group, ('SC', 'recall', 'precision')) for group in own),
            f'{np.median([one.cpu_ms for group in own for one in group]):.0f}'])
    return table(('method', 'n', *map(noise_text, noises), 'CPU ms'), lines)


def grouped(samples: Sequence[Sample]) -> dict[tuple[str, Noise, str], list[Sample]]:
    """Return samples by kind of scene, noise and method, each in the order of its first sample."""
    orders = [list(dict.fromkeys(getattr(one, name) for one in samples))
              for name in ('kind', 'noise', 'method')]
    groups: dict[tuple[str, Noise, str], list[Sample]] = {
        key: [] for key in product(*orders)}
    for one in samples:
        groups[one.kind, one.noise, one.method].append(one)
    return {key: group for key, group in groups.items() if group}


def noise_text(noise: Noise) -> str:
    """Return the name of a sensor or the deviation of the noise."""
    return noise if isinstance(noise, str) else f'{noise:g}'


def column(group: Sequence[Sample], name: str) -> np.ndarray:
    """Return one number of every sample, (n,)."""
    return np.array([one.numbers[name] for one in group])


def means(group: Sequence[Sample], names: Sequence[str]) -> str:
    """Return the means of some numbers of all samples as text."""
    return ' / '.join(f'{known_mean(column(group, name)):.3f}' for name in names)


def _exact_cells(group: Sequence[Sample]) -> list[str]:
    covering = column(group, 'SC')
    return [f'{covering.mean():.4f}',
            f'{covering.min():.3f} ({group[covering.argmin()].scene})',
            *(f'{known_mean(column(group, name)):.4f}'
              for name in ('recall', 'precision', 'unlabelled'))]


def _curved_cells(group: Sequence[Sample]) -> list[str]:
    taken = column(group, 'curved')
    return [f'{taken.mean():.3f}', f'{taken.max():.2f}', f'{column(group, "IoU").mean():.3f}']


def _times(group: Sequence[Sample]) -> list[str]:
    cpu_ms = np.array([one.cpu_ms for one in group])
    return [f'{np.median(cpu_ms):.1f}', f'{cpu_ms.max():.1f}']
