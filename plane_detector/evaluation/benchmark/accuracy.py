# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Accuracy and time on all kinds of scenes, in one run of a few minutes.

Rendered rooms of boxes, lived-in rooms, curved surfaces and real images, with our method and
others, on seeds that were not used for tuning. --plots also draws the same numbers.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import numpy as np

from plane_detector.evaluation.benchmark import options as shared
from plane_detector.evaluation.benchmark.real_images import collect_frames
from plane_detector.evaluation.benchmark.rooms import HELD_OUT
from plane_detector.evaluation.benchmark.samples import Sample, plan, run_jobs
from plane_detector.evaluation.benchmark.tables import emit, table
from plane_detector.evaluation.metrics import MIN_PIXELS, known_mean
from plane_detector.evaluation.peers import Ours, all_methods

EXACT_TRUTH, CURVED = ('rooms', 'lived-in rooms'), 'curved'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    shared.add_scenes(parser, rooms=20, living=16, first_seed=HELD_OUT)
    parser.add_argument('--slow', type=int, default=5,
                        help='rooms of each kind for methods that take seconds')
    parser.add_argument('--only-ours', action='store_true', help='no other methods')
    parser.add_argument('--processes', type=shared.at_least_one, default=os.cpu_count() or 1)
    parser.add_argument('--plots', type=Path, metavar='FOLDER', help='write figures there')
    shared.add_data(parser)


def run(options: argparse.Namespace) -> None:
    """Print the tables, and write the figures if requested."""
    methods = [Ours()] if options.only_ours else all_methods()
    jobs = plan(methods, shared.scene_counts(options), options.first_seed, options.slow,
                collect_frames(options.data))
    samples = run_jobs(jobs, options.processes)
    report(samples)
    emit(*(f'{method.name}: absent, {method.absent}.' for method in methods if method.absent))
    if options.plots:
        from plane_detector.evaluation.benchmark.plots import write_plots
        for path in write_plots(samples, options.plots):
            emit(f'Figure: `{path}`')


def report(samples: Sequence[Sample]) -> None:
    """Print the comparison of all methods, then details of ours, curved scenes and real images."""
    for kind in EXACT_TRUTH:
        own = [one for one in samples if one.kind == kind]
        if own:
            emit(f'### {kind[0].upper()}{kind[1:]}: SC / recall / precision by noise (1/m)',
                 comparison(own))
    groups = grouped(samples)
    first = samples[0].method if samples else ''
    for title, header, cells, wanted in (
            (f'{first} in detail', ('SC', 'worst SC (seed)', 'recall', 'precision', 'unlabelled'),
             _exact_cells, lambda kind, method: kind in EXACT_TRUTH and method == first),
            ('Columns, pipes and balls',
             ('taken for planes', 'worst', 'least IoU of a plane'), _curved_cells,
             lambda kind, _: kind == CURVED),
            ('Real frames, depth of the sensor', ('planes', 'labelled', 'purity'), _frame_cells,
             lambda kind, _: kind not in (*EXACT_TRUTH, CURVED))):
        rows = [[kind, f'{sigma:g}', method, str(len(group)), *cells(group), *_times(group)]
                for (kind, sigma, method), group in groups.items() if wanted(kind, method)]
        if rows:
            emit(f'### {title}', table(('scenes', 'noise (1/m)', 'method', 'n', *header,
                                        'CPU ms, median', 'worst'), rows))
    emit(f'Recall: true planes over {MIN_PIXELS} pixels that a predicted one matches with '
         'IoU > 0.5; precision: predicted planes that match. Unlabelled: share of the pixels on '
         'true planes without a label. Taken for planes: share of the curved pixels that got a '
         'label. Purity: share of the pixels of a plane near the best plane through the sensor\'s '
         'points there. Times are of one core, from depth to labels and planes.')


def comparison(samples: Sequence[Sample]) -> str:
    """Return a Markdown table with a row for each method and a column for each noise."""
    groups = grouped(samples)
    sigmas = sorted({one.sigma for one in samples})
    lines = []
    for method in dict.fromkeys(one.method for one in samples):
        own = [group for (_, _, name), group in groups.items() if name == method]
        lines.append([method, str(len(own[0])), *(
            means(group, ('SC', 'recall', 'precision')) for group in own),
            f'{np.median([one.cpu_ms for group in own for one in group]):.0f}'])
    return table(('method', 'n', *(f'{sigma:g}' for sigma in sigmas), 'CPU ms'), lines)


def grouped(samples: Sequence[Sample]) -> dict[tuple[str, float, str], list[Sample]]:
    """Return samples by kind of scene, noise and method; kinds and methods stay in order."""
    kinds, methods = (list(dict.fromkeys(getattr(one, name) for one in samples))
                      for name in ('kind', 'method'))

    def key(one: Sample) -> tuple[int, float, int]:
        return kinds.index(one.kind), one.sigma, methods.index(one.method)

    return {(kinds[k], sigma, methods[m]): list(group) for (k, sigma, m), group in
            groupby(sorted(samples, key=key), key)}


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


def _frame_cells(group: Sequence[Sample]) -> list[str]:
    return [f'{column(group, "planes").mean():.1f}', f'{column(group, "labelled").mean():.3f}',
            f'{known_mean(column(group, "purity")):.3f}']


def _times(group: Sequence[Sample]) -> list[str]:
    cpu_ms = np.array([one.cpu_ms for one in group])
    return [f'{np.median(cpu_ms):.1f}', f'{cpu_ms.max():.1f}']
