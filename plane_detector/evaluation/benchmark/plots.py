# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of benchmarks, from the same samples as their tables. Needs matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from plane_detector.evaluation.benchmark.samples import Sample

SIZE_EDGES = (0.0, 0.01, 0.02, 0.04, 0.08, 0.16, 1.0)
"""Shares of the image."""
RECALL_SIGMA = 0.004
_MARKERS = 'osD^vPX<>'


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
    for axes, draw in zip(figure.subplots(1, 3), (draw_noise, draw_time, draw_size), strict=True):
        for marker, (name, own) in zip(_MARKERS, methods.items(), strict=False):
            draw(axes, own, marker=marker, label=name)
        axes.set_title('rooms')
        axes.grid(alpha=0.3)
    handles, names = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc='outside lower center', ncols=min(3, len(names)))
    return save_figure(figure, folder / 'accuracy.svg')


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


def draw_noise(axes: Any, own: Sequence[Sample], **style: str) -> None:
    """Draw SC over noise as a line."""
    sigmas = sorted({one.noise for one in own if not isinstance(one.noise, str)})
    covering = [np.mean([one.numbers['SC'] for one in own if one.noise == sigma])
                for sigma in sigmas]
    axes.plot(range(len(sigmas)), covering, **style)
    axes.set(xlabel='noise of 1/depth (1/m)', ylabel='segmentation covering', ylim=(0, 1.02),
             xticks=range(len(sigmas)), xticklabels=[f'{sigma:g}' for sigma in sigmas])


def draw_time(axes: Any, own: Sequence[Sample], **style: str) -> None:
    """Draw time over accuracy as a point: means over all noises."""
    axes.plot(np.mean([one.numbers['SC'] for one in own]),
              np.median([one.cpu_ms for one in own]), **style)
    axes.set(xlabel='segmentation covering, mean over all noises',
             ylabel='time on one core (ms)', xlim=(0, 1.02), yscale='log')


def draw_size(axes: Any, own: Sequence[Sample], **style: str) -> None:
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
