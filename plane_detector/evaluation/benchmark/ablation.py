# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Contribution of each stage of the segmentation: the results with one stage switched off.

The differences are paired, scene by scene. Only exact or measured depth is segmented; the stages
for the depth of networks are not included.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pkgutil import resolve_name
from typing import Any
from unittest import mock

import numpy as np

from plane_detector.evaluation.benchmark.accuracy import (
    CURVED,
    EXACT_TRUTH,
    column,
    grouped,
    means,
    noise_text,
)
from plane_detector.evaluation.benchmark.report import add_shared, emit, table
from plane_detector.evaluation.benchmark.samples import COUNTS, Sample, plan, run_jobs
from plane_detector.evaluation.datasets import labelled_frames
from plane_detector.evaluation.metrics import known_mean
from plane_detector.evaluation.peers import Ours
from plane_detector.types import PlaneSegmentation

TUNING_SEED = 8000
"""First seed; constants and stages are chosen on seeds from this one up to 9000."""
ALL = 'all of these'
# Stage: where its function is called, and the function that replaces it.
_SEGMENT = 'plane_detector.segmentation.segment'
_REGIONS = 'plane_detector.segmentation.regions'
STAGES: dict[str, tuple[str, Callable[..., Any]]] = {
    'competition for cells': (f'{_SEGMENT}.compete_for_cells', lambda frame, regions: regions),
    'depth steps': (f'{_SEGMENT}.split_at_depth_steps', lambda frame, regions, *_: regions),
    'correlated errors': (f'{_SEGMENT}.reassign_cells', lambda frame, regions, *_: regions),
    'model selection': (f'{_REGIONS}.merging.prefer_two_planes', lambda *_: False),
    'merging behind objects': (f'{_REGIONS}.merging._is_hidden_between', lambda *_: False),
    'coplanar regions': (f'{_SEGMENT}.merge_coplanar', lambda cells, graph, *_: graph),
    'sides of intersections': (
        'plane_detector.segmentation.pixels.labelling.intersections',
        lambda planes, borders: np.zeros((len(planes), len(planes)), np.int8)),
    'small planes': (f'{_SEGMENT}.add_small_planes',
                     lambda frame, labels, graph, *_: graph.planes),
    'curved regions': (f'{_SEGMENT}.find_curved', lambda *_: np.zeros(0, np.int64)),
    'narrow gaps': (f'{_SEGMENT}.close_gaps', lambda *_: None),
    'nearly flat regions': (f'{_SEGMENT}.join_nearly_flat',
                            lambda cells, graph, *_: (graph.owner, graph.planes))}


class Without(Ours):
    """Our method without some stages."""

    def __init__(self, name: str, stages: Sequence[str]) -> None:
        super().__init__()
        self.name, self._stages = name, tuple(stages)

    def run(self, prepared: Any) -> PlaneSegmentation:
        """Segment."""
        with switched_off(self._stages):
            return super().run(prepared)


@contextmanager
def switched_off(stages: Sequence[str]) -> Iterator[None]:
    """Replace stages of :data:`STAGES` by functions that change nothing."""
    with ExitStack() as patches:
        for stage in stages:
            place, instead = STAGES[stage]
            owner, _, function = place.rpartition('.')
            patches.enter_context(mock.patch.object(resolve_name(owner), function, instead))
        yield


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('--only', default='', help='stages whose name contains this')
    parser.add_argument('--labelled', action='store_true',
                        help='only the frames whose planes were labelled by hand')
    add_shared(parser, *COUNTS, '--first-seed', '--processes', '--data',
               rooms=40, living=32, first_seed=TUNING_SEED)


def run(options: argparse.Namespace) -> None:
    """Print the tables."""
    wanted = [name for name in STAGES if options.only in name]
    if not wanted:
        raise ValueError(f'no stage is called {options.only}: there are {", ".join(STAGES)}')
    methods = [Ours(), *(Without(name, [name]) for name in wanted)]
    if len(wanted) > 1:
        methods.append(Without(ALL, wanted))
    by_hand = labelled_frames(options.data)
    counts = {'rooms': 0, 'living': 0, 'curved': 0} if options.labelled else vars(options)
    report(run_jobs(plan(methods, counts, options.first_seed, 0, by_hand), options.processes))


def report(samples: Sequence[Sample]) -> None:
    """Print tables of the metrics with all stages, and of the changes without each."""
    by_hand = [one for one in samples if 'pieces' in one.numbers]
    for title, own, metrics in (
            ('Planes labelled by hand: SC / recall / pieces', by_hand,
             ('SC', 'recall', 'pieces')),
            *((f'{kind[0].upper()}{kind[1:]}: SC / recall / precision by noise (1/m)',
               [one for one in samples if one.kind == kind], ('SC', 'recall', 'precision'))
              for kind in EXACT_TRUTH),
            ('Columns, pipes and balls: taken for planes / least IoU of a plane',
             [one for one in samples if one.kind == CURVED], ('curved', 'IoU'))):
        if own:
            emit(f'### {title}', changes(own, metrics))
    emit('First row: all stages. The others: the change without a stage; in brackets the standard '
         'error of the change of the first metric.')


def changes(samples: Sequence[Sample], metrics: Sequence[str]) -> str:
    """Return a Markdown table with a row for each method and a column for each set of scenes."""
    groups = grouped(samples)
    first, *others = dict.fromkeys(one.method for one in samples)
    sets = dict.fromkeys((kind, noise) for kind, noise, _ in groups)
    full = [groups[(*one, first)] for one in sets]
    rows = [['all stages', *(means(group, metrics) for group in full)]]
    for method in others:
        rows.append([f'without {method}', *(
            _change(before, groups[(*one, method)], metrics)
            for one, before in zip(sets, full, strict=True))])
    is_by_noise = len({kind for kind, _ in sets}) == 1
    return table(('', *(noise_text(noise) if is_by_noise else kind for kind, noise in sets)), rows)


def _change(before: Sequence[Sample], after: Sequence[Sample], metrics: Sequence[str]) -> str:
    """Return the mean changes of the metrics, and the standard error of the first."""
    by_scene = [column(after, name) - column(before, name) for name in metrics]
    error = np.nanstd(by_scene[0]) / np.sqrt(len(before))
    first, *rest = (f'{known_mean(change):+.3f}' for change in by_scene)
    return ' / '.join([f'{first} ({error:.3f})', *rest])
