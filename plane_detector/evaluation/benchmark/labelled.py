# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Accuracy of our and other methods on real frames with planes labelled by hand."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from skimage.measure import label

from plane_detector.config import Config, RansacConfig
from plane_detector.drawing import figure, overlay
from plane_detector.evaluation.benchmark.report import (
    HELD_OUT,
    add_shared,
    emit,
    in_parallel,
    table,
)
from plane_detector.evaluation.benchmark.samples import labelled_numbers
from plane_detector.evaluation.datasets import (
    ABW,
    OF_TODAY,
    TABLETOPS,
    Frame,
    LabelledFrame,
    ZeroPlaneFrame,
    frames,
    labelled_frames,
    zeroplane_frames,
)
from plane_detector.evaluation.metrics import (
    MIN_PIXELS,
    covering_of_truth,
    found_within,
    hoover_score,
    known_mean,
    overlap,
    segmentation_covering,
)
from plane_detector.evaluation.peers import Method, OpenCv, Ours, Paper
from plane_detector.evaluation.reference_planes import fit_planes, plane_depth
from plane_detector.evaluation.scenes.sensor_cases import SENSOR_CASES
from plane_detector.pipeline import segment_planes
from plane_detector.types import CameraIntrinsics

SEEDS, DRAWS, NOISE_SHARE = 6, 3, 5e-4
"""The largest surface of a frame must not depend on these: seeds of RANSAC, draws of noise of this
share of the depth, and half the size."""
KEPT_SHARE = 0.8
"""A surface is kept if this share of it is in one plane."""
UNSEEN_SETS = ('kitchen',)
"""Real frames without labels for which --pictures also writes pictures."""
ABW_MIN_SHARE = 0.001
"""Smallest plane on ABW: its regions are small, and each published method was tuned for them."""
APART = ('correct', 'missed', 'noise')
"""The Hoover scores that are also counted for connected pieces, like ABW's labels."""
LIMITS_MM = (1, 5, 10)
"""Mean differences of depth up to which a plane of ZeroPlane's packs counts as found."""
_PANEL_WIDTH_PX = 640


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('--frames', action='store_true', help='also a table of all frames')
    parser.add_argument('--slow', action='store_true', help='also the method of the paper')
    parser.add_argument('--pictures', type=Path, metavar='FOLDER',
                        help='write image, true labels and ours there, also of the sets '
                             f'{", ".join(UNSEEN_SETS)}, which have no labels')
    parser.add_argument('--zeroplane', type=Path, metavar='FOLDER',
                        help='instead of the labelled sets: a test pack of ZeroPlane, a folder '
                             'of .npz files')
    add_shared(parser, '--only-ours', '--processes', '--data', processes=1)


def run(options: argparse.Namespace) -> None:
    """Print the tables, and write the pictures if requested."""
    if options.zeroplane:
        report_zeroplane(options)
        return
    found = list(labelled_frames(options.data))
    by_hand, scanned = ([one for one in found if (one.set_name == ABW) is scan]
                        for scan in (False, True))
    paper = [Paper()] if options.slow else []
    report('Planes labelled by hand', by_hand, [Ours(), OpenCv(0.03), OpenCv(0.05), *paper],
           labelled_numbers, 3, options)
    emit('Only labelled pixels count. Recall: true planes that a predicted one matches with '
         'IoU > 0.5. Pieces: predicted planes with over a tenth of a true plane\'s pixels, per '
         f'true plane. Both are of true planes over {MIN_PIXELS} pixels. Merged: of the '
         'predicted planes with over half of a true plane, those with over half of two or more. '
         'Unlabelled: share of the true planes\' pixels without a plane. '
         f'On {TABLETOPS} the truth is one table; planes on its objects count as none.')
    report_largest([one for one in by_hand if one.set_name == OF_TODAY], options.processes)
    if scanned:
        fine, peer = Ours(_with_min_share(ABW_MIN_SHARE)), OpenCv(0.003, ABW_MIN_SHARE)
        fine.name = f'plane_detector, min_plane_share {ABW_MIN_SHARE:g}'
        peer.name += f', min_size {ABW_MIN_SHARE:g} of the image'
        report('ABW structured light scanner, regions per image at 80 % mutual overlap', scanned,
               [Ours(), fine, peer, *paper], hoover_numbers, 1, options)
        emit('The true labels of ABW have a region for each connected piece: a floor between '
             'shadows is several. Apart: each connected piece of a plane counts as a region.')
    if options.pictures:
        for path in write_pictures(options.data, found, options.pictures):
            emit(f'Picture: `{path}`')


def report_zeroplane(options: argparse.Namespace) -> None:
    """Print the table of a test pack, whose true planes have a depth."""
    report('Test pack of ZeroPlane, from its measured depth', zeroplane_frames(options.zeroplane),
           [Ours(), OpenCv(0.03), OpenCv(0.05), *([Paper()] if options.slow else [])],
           zeroplane_numbers, 3, options)
    emit('SC: symmetric, over the pixels with measured depth, as in all our tables. SC of truth: '
         'of the true segments alone, over all pixels, as some publications have it. Precision '
         'and recall: planes with IoU > 0.5 whose depths differ by at most the limit in the mean.')


def zeroplane_numbers(frame: ZeroPlaneFrame, labels: np.ndarray) -> dict[str, float]:
    """Return SC in both conventions, and precision and recall at LIMITS_MM."""
    measured = np.isfinite(frame.depth_m)
    depth_m = plane_depth(labels, fit_planes(labels, frame.depth_m, frame.intrinsics),
                          frame.intrinsics)
    found = found_within(frame.labels, frame.plane_depth_m, labels, depth_m, measured,
                         [limit / 1000 for limit in LIMITS_MM])
    everywhere = overlap(frame.labels, labels, np.ones_like(measured))
    return {'SC': segmentation_covering(overlap(frame.labels, labels, measured).counts),
            'SC of truth': covering_of_truth(everywhere.counts),
            **{f'{name} {limit} mm': share
               for name, shares in zip(('precision', 'recall'), found, strict=True)
               for limit, share in zip(LIMITS_MM, shares, strict=True)}}


def report_largest(found: Sequence[LabelledFrame], processes: int) -> None:
    """Print the share of the largest surface that is in one plane, and of simulated sensors."""
    names = (*(f'seed {k}' for k in range(SEEDS)), *(f'noise {k}' for k in range(DRAWS)), 'half')
    simulated = [_simulated(name, seed) for name in SENSOR_CASES for seed in range(3)]
    for title, members in (('Largest surface of a frame in one plane', found),
                           ('The same of simulated sensors', simulated)):
        if not members:
            continue
        shares = np.array(list(in_parallel(largest_surface, members, processes, title)))
        emit(f'### {title}', table(
            ('frame', *names), [[frame.name, *(f'{share:.2f}' for share in row)]
                                for frame, row in zip(members, shares, strict=True)]))
        emit(f'At least {KEPT_SHARE:g} in {np.count_nonzero(shares >= KEPT_SHARE)} of '
             f'{shares.size}, worst {shares.min():.2f}.')


def largest_surface(frame: LabelledFrame) -> list[float]:
    """Return the share of the largest labelled surface in one plane by seed, noise and size."""
    shares = []
    for seed in range(SEEDS):
        config = replace(Config(), ransac=replace(RansacConfig(), seed=seed))
        shares.append(share_in_one_plane(
            segment_planes(frame.depth_m, frame.intrinsics, config).labels, frame))
    for draw in range(DRAWS):
        rng = np.random.default_rng(draw)
        noisy_m = frame.depth_m * (1 + NOISE_SHARE * rng.standard_normal(frame.depth_m.shape))
        shares.append(share_in_one_plane(
            segment_planes(noisy_m.astype(np.float32), frame.intrinsics).labels, frame))
    camera, depth_m = frame.intrinsics, np.ascontiguousarray(frame.depth_m[::2, ::2])
    half = replace(frame, depth_m=depth_m, labels=frame.labels[::2, ::2], intrinsics=(
        CameraIntrinsics(camera.fx / 2, camera.fy / 2, camera.cx / 2, camera.cy / 2,
                         *depth_m.shape[::-1])))
    found = segment_planes(half.depth_m, half.intrinsics).labels
    return [*shares, share_in_one_plane(found, half)]


def share_in_one_plane(labels: np.ndarray, frame: LabelledFrame) -> float:
    """Return the largest share of the frame's largest surface that has one label."""
    valid = np.isfinite(frame.depth_m)
    largest = np.bincount(frame.labels[valid & (frame.labels >= 0)]).argmax()
    names = labels[valid & (frame.labels == largest)]
    return float(np.bincount(names[names >= 0], minlength=1).max() / len(names))


def _simulated(name: str, seed: int) -> LabelledFrame:
    scene, depth_m = SENSOR_CASES[name](np.random.default_rng(HELD_OUT + seed))
    return LabelledFrame(OF_TODAY, f'{name} {HELD_OUT + seed}', scene.rgb, depth_m,
                         scene.intrinsics, scene.labels)


def _with_min_share(share: float) -> Config:
    config = Config()
    return replace(config, segmentation=replace(config.segmentation, min_plane_share=share))


def hoover_numbers(frame: LabelledFrame, labels: np.ndarray) -> dict[str, float]:
    """Return the Hoover scores of predicted labels (H, W), and those APART for its pieces."""
    pieces = label(labels, background=-1, connectivity=1) - 1
    is_large = np.bincount(pieces[pieces >= 0]) >= ABW_MIN_SHARE * labels.size
    pieces = np.where(np.append(is_large, False)[pieces], pieces, -1)
    whole, apart = (hoover_score(np.maximum(frame.labels, -1), one, np.isfinite(frame.depth_m))
                    for one in (labels, pieces))
    return whole | {f'{name}, apart': apart[name] for name in APART}


def report(title: str, found: Sequence[LabelledFrame], methods: Sequence[Method],
           numbers_of: Callable[[Any, np.ndarray], dict[str, float]], digits: int,
           options: argparse.Namespace) -> None:
    """Print the means over each set and, if requested, the numbers of each frame."""
    rows, lines = [], []
    for method in methods:
        if method.absent:
            emit(f'{method.name}: absent, {method.absent}.')
        if method.absent or (options.only_ours and not isinstance(method, Ours)):
            continue
        labels = in_parallel(partial(_labels, method), found, options.processes, method.name)
        for name, group in groupby(zip(found, labels, strict=True), lambda one: one[0].set_name):
            members = [(frame.name, numbers_of(frame, one)) for frame, one in group]
            names = list(members[0][1])
            values = np.array([list(numbers.values()) for _, numbers in members], float)
            lines += [[f'{name}/{frame}', method.name, *(f'{one:.{digits}f}' for one in own)]
                      for (frame, _), own in zip(members, values, strict=True)]
            rows.append([name, method.name, len(members), *(
                f'{known_mean(one):.{digits}f}' for one in values.T)])
    emit(f'### {title}', table(('set', 'method', 'n', *names),
                               sorted(rows, key=lambda row: row[0])))
    if options.frames:
        emit(table(('frame', 'method', *names), sorted(lines, key=lambda line: line[0])))


def _labels(method: Method, frame: Frame) -> np.ndarray:
    return method(frame.depth_m, frame.intrinsics)[0]


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
