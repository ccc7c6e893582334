# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Planes of NYU Depth V2: our method, the paper's method, RANSAC alone and findPlanes.

Each is run on the depth of the sensor and of the network; the truth is the flat parts of annotated
instances.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping, Sequence
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from tqdm import tqdm

from plane_detector.config import Config, DepthConfig, ScaleConfig, TrackingConfig
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.evaluation.annotated_planes import annotated_planes
from plane_detector.evaluation.benchmark import options as shared
from plane_detector.evaluation.benchmark.parallel import mapping
from plane_detector.evaluation.benchmark.samples import timed
from plane_detector.evaluation.benchmark.tables import emit, table
from plane_detector.evaluation.metrics import (
    RECALL_ANGLES_DEG,
    RECALL_DEPTHS_M,
    depth_recall,
    known_mean,
    normal_recall,
    score,
)
from plane_detector.evaluation.nyu_depth import DEPTHS, NyuDepth, NyuFrame, read_split
from plane_detector.evaluation.peers import (
    OpenCv,
    Ours,
    Paper,
    PlainRansac,
    Segments,
    plane_array,
)
from plane_detector.evaluation.plane_geometry import plane_depth
from plane_detector.pipeline import PlaneDetector

NO_MODEL, OURS = 'none', 'ours'
METHODS = {OURS: Ours, 'paper': Paper, 'ransac': PlainRansac, 'opencv': lambda: OpenCv(0.03)}
Numbers = dict[str, float]
"""Metric to value; NaN where it is undefined."""
BY_DEPTH = [f'{depth_m:g} m' for depth_m in RECALL_DEPTHS_M]
BY_ANGLE = [f'{angle_deg:g} deg' for angle_deg in RECALL_ANGLES_DEG]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('file', type=Path, help='nyu_depth_v2_labeled.mat')
    parser.add_argument('--split', type=Path, help='splits.mat, or a text file of frame numbers')
    parser.add_argument('--part', choices=('test', 'train'), default='test',
                        help='of splits.mat')
    parser.add_argument('--depth', choices=DEPTHS, default='raw')
    parser.add_argument('--methods', type=_methods, default=tuple(METHODS), metavar='NAME,...',
                        help=f'some of {", ".join(METHODS)}; default all')
    parser.add_argument('--model', default='auto',
                        help=f'depth network, as depth.model; {NO_MODEL}: sensor only')
    parser.add_argument('--worst', type=shared.at_least_one, default=5,
                        help='frames to name for each method')
    parser.add_argument('--processes', type=shared.at_least_one, default=os.cpu_count() or 1)


def _methods(text: str) -> tuple[str, ...]:
    wanted = tuple(text.split(','))
    if not set(wanted) <= set(METHODS):
        raise argparse.ArgumentTypeError(f'{text}: there are {", ".join(METHODS)}')
    return wanted


def run(options: argparse.Namespace) -> None:
    """Evaluate the frames, print the tables."""
    path = options.file.resolve()
    numbers = _chosen_frames(path, options.split, options.part)
    each = partial(evaluate, path, options.depth, options.methods,
                   '' if options.model == NO_MODEL else options.model)
    with mapping(options.processes) as apply:
        results = dict(zip(numbers, tqdm(apply(each, numbers), 'frames', total=len(numbers)),
                           strict=True))
    for name in options.methods:
        if METHODS[name]().absent:
            emit(f'{name}: absent, {METHODS[name]().absent}.')
    rows: dict[str, dict[int, Numbers]] = {}
    for number, found in results.items():
        for name, numbers_of_row in found.items():
            rows.setdefault(name, {})[number] = numbers_of_row
    emit(f'### NYU Depth V2, {len(results)} frames, {options.depth} depth',
         *summary(rows, options.worst))


def _chosen_frames(path: Path, split: Path | None, part: str) -> Sequence[int]:
    """Return the frame numbers of a split; all frames without one."""
    file = opened(path)
    if not file.has_annotations:
        raise ValueError(f'{path} has no labels and instances')
    numbers = read_split(split, part) if split else range(1, len(file) + 1)
    if not 1 <= min(numbers) <= max(numbers) <= len(file):
        raise ValueError(f'{split} names frames that {path} does not have; it has {len(file)}')
    return numbers


def evaluate(path: Path, depth: str, methods: Sequence[str], model: str,
             number: int) -> dict[str, Numbers]:
    """Return the metrics of all methods on a frame, by name of the row."""
    frame = opened(path).frame(number, depth)
    truth = annotated_planes(frame.segments, frame.depth_m, frame.intrinsics,
                             np.random.default_rng(number))
    return {name: numbers_of(frame, truth, segments) | {'CPU ms': taken_ms}
            for name, segments, taken_ms in _segmentations(frame, methods, model)}


def _segmentations(frame: NyuFrame, names: Sequence[str],
                   model: str) -> list[tuple[str, Segments, float]]:
    """Return name, planes and CPU milliseconds of every method on the depth of each source."""
    methods = {name: method for name in names if not (method := METHODS[name]()).absent}
    found = [(f'{method.name}, sensor', *timed(method, frame.depth_m, frame.intrinsics))
             for method in methods.values()]
    if model:
        detector = _detector(model)
        detector.reset()
        # The sensor's depth fixes the scale of a relative network.
        scale_depth = [frame.depth_m] * (detector.config.scale.method == 'depth_topic')
        detection = detector.detect(frame.rgb, frame.intrinsics, *scale_depth)
        for name, method in methods.items():
            # Ours is the whole pipeline; its time would include that of the network.
            result = (((detection.labels, plane_array(detection)), float('nan'))
                      if name == OURS else timed(method, detection.depth_m, frame.intrinsics))
            found.append((f'{method.name}, network', *result))
    return found


@lru_cache(maxsize=1)
def opened(path: Path) -> NyuDepth:
    """Return the file, opened once per process."""
    return NyuDepth(path)


@lru_cache(maxsize=1)
def _detector(model: str) -> PlaneDetector:
    estimate = DepthEstimator(DepthConfig(model=model))
    method = 'depth_topic' if estimate.output == 'relative_disparity' else 'metric'
    return PlaneDetector(Config(scale=ScaleConfig(method=method),
                                tracking=TrackingConfig(enabled=False)), estimate)


def numbers_of(frame: NyuFrame, truth: Segments, found: Segments) -> Numbers:
    """Return all metrics of predicted labels (H, W) and planes (J, 4) on a frame."""
    (true_labels, true_planes), (labels, planes) = truth, found
    mask = np.isfinite(frame.depth_m)
    one = score(true_labels, true_planes, labels, planes, mask)
    numbers = {'SC': one.segmentation_covering, 'VOI': one.variation_of_information,
               'RI': one.rand_index, 'recall': one.recall, 'precision': one.precision,
               'normal error': one.normal_error_deg, 'offset error': one.offset_error_m,
               'true planes': float(len(true_planes)),
               'true pixels': float(np.count_nonzero(mask & (true_labels >= 0)))}
    if len(true_planes):
        depth_m = plane_depth(labels, planes, frame.intrinsics)
        recalls = (*depth_recall(true_labels, frame.depth_m, labels, depth_m, mask),
                   *normal_recall(true_labels, true_planes, labels, planes, mask))
    else:
        recalls = tuple(np.full(len(names), np.nan)
                        for names in (BY_DEPTH, BY_DEPTH, BY_ANGLE, BY_ANGLE))
    for kind, names, values in zip(('planes', 'pixels') * 2,
                                   (BY_DEPTH, BY_DEPTH, BY_ANGLE, BY_ANGLE), recalls, strict=True):
        numbers |= {f'{kind} {name}': float(value)
                    for name, value in zip(names, values, strict=True)}
    return numbers


def segmentation_table(rows: Mapping[str, Mapping[int, Numbers]]) -> str:
    """Return the Markdown table of the metrics without coefficients; rows by name and frame."""
    header = ('method', 'frames', 'SC', 'worst SC (frame)', 'VOI', 'RI', 'recall', 'precision',
              'normal error (deg)', 'offset error (cm)')
    lines = []
    for name, frames in rows.items():
        worst = min(frames, key=lambda number, frames=frames: frames[number]['SC'])
        lines.append([name, len(frames), f'{mean(frames, "SC"):.4f}',
                      f'{frames[worst]["SC"]:.3f} ({worst})', f'{mean(frames, "VOI"):.3f}',
                      f'{mean(frames, "RI"):.4f}', f'{mean(frames, "recall"):.4f}',
                      f'{mean(frames, "precision"):.4f}', f'{mean(frames, "normal error"):.2f}',
                      f'{100 * mean(frames, "offset error"):.1f}'])
    return table(header, lines)


def recall_table(rows: Mapping[str, Mapping[int, Numbers]]) -> str:
    """Return the Markdown table of recalls by depth and angle: planes / pixels."""
    lines = [[name, *(f'{100 * pooled(frames, f"planes {limit}", "true planes"):.1f} / '
                      f'{100 * pooled(frames, f"pixels {limit}", "true pixels"):.1f}'
                      for limit in (*BY_DEPTH, *BY_ANGLE))] for name, frames in rows.items()]
    return table(('method', *BY_DEPTH, *BY_ANGLE), lines)


def worst_table(rows: Mapping[str, Mapping[int, Numbers]], count: int) -> str:
    """Return the Markdown table of the frames with the lowest SC, by method."""
    lines = [[name, ', '.join(f'{number} ({frames[number]["SC"]:.2f})' for number in sorted(
        frames, key=lambda number, frames=frames: frames[number]['SC'])[:count])]
        for name, frames in rows.items()]
    return table(('method', f'{count} worst frames (SC)'), lines)


def time_table(rows: Mapping[str, Mapping[int, Numbers]]) -> str:
    """Return the Markdown table of the times, where they are known."""
    taken = {name: [numbers['CPU ms'] for numbers in frames.values()]
             for name, frames in rows.items()}
    return table(('method', 'CPU ms, median', 'worst'), [
        [name, f'{np.median(cpu_ms):.1f}', f'{np.max(cpu_ms):.1f}']
        for name, cpu_ms in taken.items() if np.isfinite(cpu_ms).all()])


def mean(frames: Mapping[int, Numbers], name: str) -> float:
    """Return the mean of a metric over the frames where it is defined."""
    return known_mean(np.array([numbers[name] for numbers in frames.values()]))


def pooled(frames: Mapping[int, Numbers], name: str, weight: str) -> float:
    """Return a recall over the planes or pixels of all frames together."""
    pairs = np.array([(numbers[name], numbers[weight]) for numbers in frames.values()
                      if numbers[weight] > 0]).reshape(-1, 2)
    return float(np.average(pairs[:, 0], weights=pairs[:, 1])) if len(pairs) else float('nan')


def summary(rows: Mapping[str, Mapping[int, Numbers]], worst: int) -> Sequence[str]:
    """Return all tables with explanations, as blocks of Markdown."""
    return (segmentation_table(rows),
            'Means over the frames. Recall: true planes over 1500 pixels matched by IoU > 0.5; '
            'precision: predicted planes that match; errors: medians over the matches of a frame.',
            recall_table(rows),
            'Recall in percent, planes / pixels, over all frames together: IoU > 0.5 and depth or '
            'normal within the limit.', worst_table(rows, worst), time_table(rows))
