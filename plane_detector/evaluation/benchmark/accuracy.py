# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Accuracy and time on all kinds of scenes, in one run of a few minutes.

Rendered rooms of boxes, lived-in rooms and curved surfaces, with our method and others, on seeds
that were not used for tuning. --plots also draws the same numbers, which needs matplotlib.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from plane_detector.evaluation.benchmark.report import (
    add_shared,
    emit,
    new_figure,
    save_figure,
    table,
)
from plane_detector.evaluation.benchmark.samples import COUNTS, Noise, Sample, plan, run_jobs
from plane_detector.evaluation.metrics import MIN_PIXELS, known_mean
from plane_detector.evaluation.peers import Ours, all_methods

EXACT_TRUTH, CURVED = ('rooms', 'lived-in rooms'), 'curved'
SIZE_EDGES = (0.0, 0.01, 0.02, 0.04, 0.08, 0.16, 1.0)
"""Sizes of planes in the figure, as shares of the image."""
RECALL_SIGMA = 0.004
_MARKERS = 'osD^vPX<>'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_shared(parser, *COUNTS, '--first-seed', '--only-ours', '--processes', rooms=20, living=16)
    parser.add_argument('--slow', type=int, default=5,
                        help='rooms of each kind for methods that take seconds')
    parser.add_argument('--plots', type=Path, metavar='FOLDER', help='write accuracy.svg there')


def run(options: argparse.Namespace) -> None:
    """Print the tables, and write the figure if requested."""
    methods = [Ours()] if options.only_ours else all_methods()
    samples = run_jobs(plan(methods, vars(options), options.first_seed, options.slow),
                       options.processes)
    report(samples)
    emit(*(f'{method.name}: absent, {method.absent}.' for method in methods if method.absent))
    if options.plots:
        emit(f'Figure: `{write_figure(samples, options.plots)}`')


def report(samples: Sequence[Sample]) -> None:
    """Print the comparison of all methods, then details of ours and of curved scenes."""
    for kind, (by, is_sensor) in product(EXACT_TRUTH, (('noise (1/m)', False),
                                                       ('simulated sensor', True))):
        own = [one for one in samples
               if one.kind == kind and isinstance(one.noise, str) is is_sensor]
        if own:
            emit(f'### {kind.capitalize()}: SC / recall / precision by {by}', comparison(own))
    first = samples[0].method if samples else ''
    for title, header, cells, wanted in (
            (f'{first} in detail', ('SC', 'worst SC (seed)', 'recall', 'precision', 'unlabelled'),
             _exact_cells, lambda kind, method: kind in EXACT_TRUTH and method == first),
            ('Columns, pipes and balls',
             ('taken for planes', 'worst', 'least IoU of a plane'), _curved_cells,
             lambda kind, _: kind == CURVED)):
        rows = [[kind, noise_text(noise), method, len(group), *cells(group), *_times(group)]
                for (kind, noise, method), group in grouped(samples).items()
                if wanted(kind, method)]
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
        lines.append([method, len(own[0]), *(
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


def write_figure(samples: Sequence[Sample], folder: Path) -> Path:
    """
    Draw SC over noise, time over SC and recall over size of the rooms of boxes.

    Returns the path of ``accuracy.svg`` in the folder, which is created; ImportError says what to
    install without matplotlib.
    """
    methods: dict[str, list[Sample]] = {}
    for one in samples:
        if one.kind == 'rooms':
            methods.setdefault(one.method, []).append(one)
    figure = new_figure((12.6, 3.8))
    for axes, draw in zip(figure.subplots(1, 3), (_draw_noise, _draw_time, _draw_size),
                          strict=True):
        for marker, (name, own) in zip(_MARKERS, methods.items(), strict=False):
            draw(axes, own, marker=marker, label=name)
        axes.set_title('rooms')
        axes.grid(alpha=0.3)
    handles, names = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc='outside lower center', ncols=min(3, len(names)))
    return save_figure(figure, folder / 'accuracy.svg')


def _draw_noise(axes: Any, own: Sequence[Sample], **style: str) -> None:
    """Draw SC over noise as a line."""
    sigmas = sorted({one.noise for one in own if not isinstance(one.noise, str)})
    covering = [column([one for one in own if one.noise == sigma], 'SC').mean()
                for sigma in sigmas]
    axes.plot(range(len(sigmas)), covering, **style)
    axes.set(xlabel='noise of 1/depth (1/m)', ylabel='segmentation covering', ylim=(0, 1.02),
             xticks=range(len(sigmas)), xticklabels=[f'{sigma:g}' for sigma in sigmas])


def _draw_time(axes: Any, own: Sequence[Sample], **style: str) -> None:
    """Draw time over accuracy as a point: means over all noises."""
    axes.plot(column(own, 'SC').mean(), np.median([one.cpu_ms for one in own]), **style)
    axes.set(xlabel='segmentation covering, mean over all noises',
             ylabel='time on one core (ms)', xlim=(0, 1.02), yscale='log')


def _draw_size(axes: Any, own: Sequence[Sample], **style: str) -> None:
    """Draw the share of true planes that were found over their size as a line."""
    noisy = [one for one in own if one.noise == RECALL_SIGMA]
    shares = np.concatenate([np.zeros(0), *(one.plane_shares for one in noisy)])
    found = np.concatenate([np.zeros(0, bool), *(one.found for one in noisy)])
    counts, hits = (np.histogram(values, SIZE_EDGES)[0] for values in (shares, shares[found]))
    recall = np.divide(hits, counts, out=np.full(len(counts), np.nan), where=counts > 0)
    axes.plot(range(len(recall)), recall, **style)
    axes.set(xlabel=f'share of the image (%), at a noise of {RECALL_SIGMA:g} per metre',
             ylabel='recall', ylim=(0, 1.02), xticks=range(len(SIZE_EDGES) - 1),
             xticklabels=[f'{100 * low:g}-{100 * high:g}' for low, high in
                          zip(SIZE_EDGES[:-1], SIZE_EDGES[1:], strict=True)])
