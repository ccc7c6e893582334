# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Accuracy on real frames whose planes were labelled by hand, ours and other methods."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from itertools import groupby
from pathlib import Path

import cv2
import numpy as np
from skimage.measure import label

from plane_detector.config import Config
from plane_detector.drawing import figure, overlay
from plane_detector.evaluation.benchmark.options import add_shared
from plane_detector.evaluation.benchmark.parallel import mapping
from plane_detector.evaluation.benchmark.report import emit, table
from plane_detector.evaluation.benchmark.samples import labelled_numbers
from plane_detector.evaluation.datasets import (
    ABW,
    TABLETOPS,
    Frame,
    LabelledFrame,
    frames,
    labelled_frames,
)
from plane_detector.evaluation.metrics import MIN_PIXELS, hoover_score, known_mean
from plane_detector.evaluation.peers import Method, OpenCv, Ours, Paper
from plane_detector.pipeline import segment_planes

UNSEEN_SETS = ('kitchen',)
"""Real frames without labels of which --pictures also writes pictures."""
ABW_MIN_SHARE = 0.001
"""Smallest plane on ABW: its regions are small, and each published method was set for them."""
APART = ('correct', 'missed', 'noise')
"""Of the Hoover scores, those also counted with the connected pieces, as ABW's labels are."""
_PANEL_WIDTH_PX = 640

Numbers = dict[str, float]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('--frames', action='store_true', help='also a table of all frames')
    parser.add_argument('--slow', action='store_true', help='also the method of the paper')
    parser.add_argument('--pictures', type=Path, metavar='FOLDER',
                        help='write image, true labels and ours there, also of the sets '
                             f'{", ".join(UNSEEN_SETS)}, which have no labels')
    add_shared(parser, '--only-ours', '--processes', '--data', processes=1)


def run(options: argparse.Namespace) -> None:
    """Print the tables, and write the pictures if requested."""
    found = list(labelled_frames(options.data))
    by_hand, scanned = ([one for one in found if (one.set_name == ABW) is scan]
                        for scan in (False, True))
    paper = [Paper()] if options.slow else []
    report('Planes labelled by hand', by_hand, [Ours(), OpenCv(0.03), OpenCv(0.05), *paper],
           labelled_numbers, options)
    emit('Only labelled pixels count. Recall: true planes that a predicted one matches with '
         'IoU > 0.5. Pieces: predicted planes with over a tenth of a true plane\'s pixels, per '
         f'true plane. Both are of true planes over {MIN_PIXELS} pixels. Merged: of the '
         'predicted planes with over half of a true plane, those with over half of two or more. '
         'Unlabelled: share of the true planes\' pixels without a plane. '
         f'On {TABLETOPS} the truth is one table; planes on its objects count as none.')
    if scanned:
        fine, peer = Ours(_with_min_share(ABW_MIN_SHARE)), OpenCv(0.003, ABW_MIN_SHARE)
        fine.name = f'plane_detector, min_plane_share {ABW_MIN_SHARE:g}'
        peer.name += f', min_size {ABW_MIN_SHARE:g} of the image'
        report('ABW structured light scanner, regions per image at 80 % mutual overlap', scanned,
               [Ours(), fine, peer, *paper], hoover_numbers, options)
        emit('The true labels of ABW have a region for each connected piece: a floor between '
             'shadows is several. Apart: each connected piece of a plane counts as a region.')
    if options.pictures:
        for path in write_pictures(options.data, found, options.pictures):
            emit(f'Picture: `{path}`')


def _with_min_share(share: float) -> Config:
    config = Config()
    return replace(config, segmentation=replace(config.segmentation, min_plane_share=share))


def hoover_numbers(frame: LabelledFrame, labels: np.ndarray) -> Numbers:
    """Return the Hoover scores of predicted labels (H, W), and those APART for its pieces."""
    whole, apart = (
        {name.replace('_', '-'): float(count) for name, count in asdict(hoover_score(
            np.maximum(frame.labels, -1), one, np.isfinite(frame.depth_m))).items()}
        for one in (labels, _connected_pieces(labels)))
    return whole | {f'{name}, apart': apart[name] for name in APART}


def _connected_pieces(labels: np.ndarray) -> np.ndarray:
    """Return labels (H, W) of the connected pieces, without those below ABW_MIN_SHARE."""
    pieces = label(labels, background=-1, connectivity=1) - 1
    is_large = np.bincount(pieces[pieces >= 0]) >= ABW_MIN_SHARE * labels.size
    return np.where(np.append(is_large, False)[pieces], pieces, -1)


def report(title: str, found: Sequence[LabelledFrame], methods: Sequence[Method], numbers_of,
           options: argparse.Namespace) -> None:
    """Print the means over each set and, if requested, the numbers of each frame."""
    rows, lines = [], []
    digits = 1 if numbers_of is hoover_numbers else 3
    for method in methods:
        if method.absent:
            emit(f'{method.name}: absent, {method.absent}.')
        if method.absent or (options.only_ours and not isinstance(method, Ours)):
            continue
        with mapping(options.processes) as apply:
            labels = list(apply(_labels, [method] * len(found), found))
        pairs = [(frame, numbers_of(frame, one))
                 for frame, one in zip(found, labels, strict=True)]
        lines += [[f'{frame.set_name}/{frame.name}', method.name, *_cells(numbers, digits)]
                  for frame, numbers in pairs]
        for name, group in groupby(pairs, lambda pair: pair[0].set_name):
            members = [numbers for _, numbers in group]
            rows.append([name, method.name, len(members), *_cells({
                key: known_mean(np.array([one[key] for one in members])) for key in members[0]},
                digits)])
    names = list(pairs[0][1])
    emit(f'### {title}', table(('set', 'method', 'n', *names), sorted(rows, key=_first)))
    if options.frames:
        emit(table(('frame', 'method', *names), sorted(lines, key=_first)))


def _first(row: Sequence[object]) -> object:
    return row[0]


def _labels(method: Method, frame: Frame) -> np.ndarray:
    return method(frame.depth_m, frame.intrinsics)[0]


def _cells(numbers: Mapping[str, float], digits: int) -> list[str]:
    return [f'{value:.{digits}f}' for value in numbers.values()]


def write_pictures(data: Path, found: Sequence[LabelledFrame], folder: Path) -> Iterator[Path]:
    """Write image, true labels and ours of each frame into a folder; yield the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    for frame in (*found, *frames(data, UNSEEN_SETS)):
        config = _with_min_share(ABW_MIN_SHARE) if frame.set_name == ABW else Config()
        ours = segment_planes(frame.depth_m, frame.intrinsics, config)
        panels = [(f'{frame.set_name}/{frame.name}', frame.rgb)]
        if isinstance(frame, LabelledFrame):
            panels.append((f'by hand: {frame.labels.max() + 1} planes',
                           overlay(frame.rgb, np.maximum(frame.labels, -1) + 1)))
        panels.append((f'ours: {len(ours.planes)} planes', overlay(frame.rgb, ours.labels + 1)))
        path = folder / f'{frame.set_name}_{frame.name}.png'
        size_px = _PANEL_WIDTH_PX, _PANEL_WIDTH_PX * frame.rgb.shape[0] // frame.rgb.shape[1]
        panels = [(title, cv2.resize(rgb, size_px, interpolation=cv2.INTER_AREA))
                  for title, rgb in panels]
        if not cv2.imwrite(str(path), figure(panels, len(panels))[..., ::-1]):
            raise OSError(f'{path} cannot be written')
        yield path
