# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Figure of the accuracy benchmark, from the same samples as its tables. Needs matplotlib."""

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

    Parameters
    ----------
    samples : sequence of Sample
    folder : Path
        Created if it does not exist.

    Returns
    -------
    Path
        ``accuracy.svg``.

    Raises
    ------
    ImportError
        matplotlib is not installed.

    """
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError(f'{error}: install the extra, plane_detector[benchmark]') from error
    matplotlib.use('Agg')
    # Without date and random ids, so that equal samples give equal files.
    matplotlib.rcParams.update({'svg.hashsalt': 'plane_detector', 'font.size': 9})
    folder.mkdir(parents=True, exist_ok=True)
    figure = Figure(figsize=(12.6, 3.8), layout='constrained')
    for axes, draw in zip(figure.subplots(1, 3), (draw_noise, draw_time, draw_size), strict=True):
        draw(axes, [one for one in samples if one.kind == 'rooms'])
        axes.set_title('rooms')
        axes.grid(alpha=0.3)
    handles, names = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc='outside lower center', ncols=min(3, len(names)))
    path = folder / 'accuracy.svg'
    figure.savefig(path, metadata={'Date': None})
    return path


def draw_noise(axes: Any, samples: Sequence[Sample]) -> None:
    """Draw SC over noise, one line per method."""
    sigmas = sorted({one.noise for one in samples if not isinstance(one.noise, str)})
    for marker, (method, own) in zip(_MARKERS, by_method(samples).items(), strict=False):
        covering = [np.mean([one.numbers['SC'] for one in own if one.noise == sigma])
                    for sigma in sigmas]
        axes.plot(range(len(sigmas)), covering, marker=marker, label=method)
    axes.set(xlabel='noise of 1/depth (1/m)', ylabel='segmentation covering', ylim=(0, 1.02),
             xticks=range(len(sigmas)), xticklabels=[f'{sigma:g}' for sigma in sigmas])


def draw_time(axes: Any, samples: Sequence[Sample]) -> None:
    """Draw time over accuracy, one point per method: means over all noises."""
    for marker, (method, own) in zip(_MARKERS, by_method(samples).items(), strict=False):
        axes.plot(np.mean([one.numbers['SC'] for one in own]),
                  np.median([one.cpu_ms for one in own]), marker, label=method)
    axes.set(xlabel='segmentation covering, mean over all noises',
             ylabel='time on one core (ms)', xlim=(0, 1.02), yscale='log')


def draw_size(axes: Any, samples: Sequence[Sample]) -> None:
    """Draw recall over the size of the true plane, one line per method."""
    for marker, (method, own) in zip(_MARKERS, by_method(samples).items(), strict=False):
        recall = recall_by_size([one for one in own if one.noise == RECALL_SIGMA])
        axes.plot(range(len(recall)), recall, marker=marker, label=method)
    axes.set(xlabel=f'share of the image (%), at a noise of {RECALL_SIGMA:g} per metre',
             ylabel='recall', ylim=(0, 1.02), xticks=range(len(SIZE_EDGES) - 1),
             xticklabels=[f'{100 * low:g}-{100 * high:g}' for low, high in
                          zip(SIZE_EDGES[:-1], SIZE_EDGES[1:], strict=True)])


def by_method(samples: Sequence[Sample]) -> dict[str, list[Sample]]:
    """Return the samples of each method, in the order of the methods."""
    found: dict[str, list[Sample]] = {}
    for one in samples:
        found.setdefault(one.method, []).append(one)
    return found


def recall_by_size(samples: Sequence[Sample]) -> np.ndarray:
    """Return the share of true planes found between SIZE_EDGES; NaN if there are none."""
    shares = np.concatenate([np.zeros(0), *(one.plane_shares for one in samples)])
    found = np.concatenate([np.zeros(0, bool), *(one.found for one in samples)])
    counts, hits = (np.histogram(values, SIZE_EDGES)[0] for values in (shares, shares[found]))
    return np.divide(hits, counts, out=np.full(len(counts), np.nan), where=counts > 0)
