# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Planes of NYU Depth V2: our method, the paper's method, RANSAC alone and findPlanes.

Each is run on the depth of the sensor and of the network; the truth is the flat parts of annotated
instances. The file ``nyu_depth_v2_labeled.mat`` is MATLAB 7.3, which is HDF5 with reversed axes:
H x W x 3 x N is N x 3 x W x H. Frames are counted from 1, as in the split file. Needs h5py.

References
----------
N. Silberman, D. Hoiem, P. Kohli, R. Fergus: Indoor Segmentation and Support Inference from RGBD
Images, ECCV 2012; calibration and border are from the toolbox of the data set.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from plane_detector.config import Config, DepthConfig, ScaleConfig, TrackingConfig
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.evaluation.benchmark.report import add_shared, emit, in_parallel, table
from plane_detector.evaluation.benchmark.samples import timed
from plane_detector.evaluation.datasets import numbered
from plane_detector.evaluation.metrics import (
    RECALL_ANGLES_DEG,
    RECALL_DEPTHS_M,
    known_mean,
    recall_by_error,
    score,
)
from plane_detector.evaluation.peers import OpenCv, Ours, Paper, PlainRansac, Segments, plane_array
from plane_detector.evaluation.reference_planes import annotated_planes, plane_depth
from plane_detector.geometry.disparity import UNITLESS
from plane_detector.pipeline import PlaneDetector
from plane_detector.types import CameraIntrinsics

# The toolbox counts pixels from 1, CameraIntrinsics from 0.
INTRINSICS = CameraIntrinsics(518.85790117450188, 519.46961112127485, 325.58244941119034 - 1,
                              253.73616633400465 - 1, 640, 480)
# Rows and columns that both cameras see; outside of them the images are white.
ROWS, COLUMNS = slice(44, 471), slice(40, 601)
# The toolbox limits larger depths to this.
MAX_DEPTH_M = 10.0
DEPTHS = {'raw': 'rawDepths', 'filled': 'depths'}
NO_MODEL, OURS = 'none', 'ours'
METHODS = {OURS: Ours, 'paper': Paper, 'ransac': PlainRansac, 'opencv': lambda: OpenCv(0.03)}
LIMITS = [*(f'{depth_m:g} m' for depth_m in RECALL_DEPTHS_M),
          *(f'{angle_deg:g} deg' for angle_deg in RECALL_ANGLES_DEG)]
Numbers = dict[str, float]
"""Metric to value; NaN where it is undefined."""
Rows = Mapping[str, Mapping[int, Numbers]]
"""Numbers by method and frame."""


@dataclass(frozen=True)
class NyuFrame:
    """A frame without its border."""

    rgb: np.ndarray  # (H, W, 3) uint8
    depth_m: np.ndarray  # (H, W) float32: naN where not measured
    # (H, W) int32: index of each annotated instance, 0 for pixels without annotation
    segments: np.ndarray
    intrinsics: CameraIntrinsics


class NyuDepth:
    """The opened file; an error says what is missing."""

    def __init__(self, path: Path) -> None:
        try:
            import h5py
        except ImportError as error:
            raise ImportError('reading MATLAB 7.3 files needs h5py: pip install h5py, or the '
                              'extra plane_detector[benchmark]') from error
        if not path.is_file():
            raise FileNotFoundError(f'there is no file {path}; nyu_depth_v2_labeled.mat is on the '
                                    'page of NYU Depth V2')
        try:
            self._file = h5py.File(path, 'r')
        except OSError as error:
            raise ValueError(f'{path} is not a MATLAB 7.3 (HDF5) file: {error}') from error
        missing = [name for name in ('images', *DEPTHS.values(), 'labels', 'instances')
                   if name not in self._file]
        if missing:
            raise ValueError(f'{path} has no data set {", ".join(missing)}')

    def __len__(self) -> int:
        return self._file['images'].shape[0]

    def frame(self, number: int, depth: str = 'raw') -> NyuFrame:
        """Read a frame, counted from 1, with ``raw`` depth of the sensor or ``filled`` depth."""
        if not 1 <= number <= len(self):
            raise ValueError(f'there is no frame {number}; there are 1 to {len(self)}')
        rgb, depth_m, category, instance = (
            np.ascontiguousarray(self._file[name][number - 1].T[ROWS, COLUMNS])
            for name in ('images', DEPTHS[depth], 'labels', 'instances'))
        depth_m = depth_m.astype(np.float32)
        depth_m[~((depth_m > 0) & (depth_m < MAX_DEPTH_M))] = np.nan
        segments = numbered(category.astype(np.int64) * 1000 + instance, category > 0)
        return NyuFrame(rgb, depth_m, segments + 1,
                        replace(INTRINSICS, cx=INTRINSICS.cx - COLUMNS.start,
                                cy=INTRINSICS.cy - ROWS.start, width=COLUMNS.stop - COLUMNS.start,
                                height=ROWS.stop - ROWS.start))


def read_split(path: Path) -> tuple[int, ...]:
    """Return the numbers, from 1, of the test frames of splits.mat, or those in a text file."""
    from scipy.io import loadmat
    if not path.is_file():
        raise FileNotFoundError(f'there is no file {path}')
    try:
        if path.suffix == '.mat':
            numbers = np.ravel(loadmat(path)['testNdxs']).astype(int)
        else:
            numbers = np.array(path.read_text().replace(',', ' ').split(), int)
    except (KeyError, ValueError, NotImplementedError) as error:
        raise ValueError(f'{path} is not a list of frame numbers: {error}') from error
    if not numbers.size:
        raise ValueError(f'{path} is empty')
    return tuple(numbers.tolist())


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('file', type=Path, help='nyu_depth_v2_labeled.mat')
    parser.add_argument('--split', type=Path,
                        help='splits.mat, of which the test frames are used, or a text file of '
                             'frame numbers')
    parser.add_argument('--depth', choices=DEPTHS, default='raw')
    parser.add_argument('--methods', nargs='+', choices=METHODS, default=tuple(METHODS))
    add_shared(parser, '--model', '--processes', model='auto')


def run(options: argparse.Namespace) -> None:
    """Evaluate the frames, print the tables."""
    path = options.file.resolve()
    file = opened(path)
    numbers = read_split(options.split) if options.split else range(1, len(file) + 1)
    each = partial(evaluate, path, options.depth, options.methods,
                   '' if options.model == NO_MODEL else options.model)
    rows: dict[str, dict[int, Numbers]] = {}
    for number, of_methods in zip(numbers, in_parallel(each, numbers, options.processes, 'frames'),
                                  strict=True):
        for name, numbers_of_row in of_methods.items():
            rows.setdefault(name, {})[number] = numbers_of_row
    emit(*(f'{name}: absent, {METHODS[name]().absent}.' for name in options.methods
           if METHODS[name]().absent))
    emit(f'### NYU Depth V2, {len(numbers)} frames, {options.depth} depth',
         segmentation_table(rows),
         'Means over the frames. Recall: true planes over 1500 pixels matched by IoU > 0.5; '
         'precision: predicted planes that match; errors: medians over the matches of a frame. '
         'Times: medians, of one core.', recall_table(rows),
         'Recall in percent, planes / pixels, over all frames together: IoU > 0.5 and depth or '
         'normal within the limit.')


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
    method = 'depth_topic' if estimate.output in UNITLESS else 'metric'
    return PlaneDetector(Config(scale=ScaleConfig(method=method),
                                tracking=TrackingConfig(enabled=False)), estimate)


def numbers_of(frame: NyuFrame, truth: Segments, found: Segments) -> Numbers:
    """Return all metrics of predicted labels (H, W) and planes (J, 4) on a frame."""
    (true_labels, true_planes), (labels, planes) = truth, found
    mask = np.isfinite(frame.depth_m)
    one = score(true_labels, true_planes, labels, planes, mask)
    numbers = {'SC': one.segmentation_covering, 'VOI': one.variation_of_information,
               'RI': one.rand_index, 'recall': one.recall, 'precision': one.precision,
               'normal error': one.normal_error_deg, 'offset error': 100 * one.offset_error_m,
               'true planes': float(len(true_planes)),
               'true pixels': float(np.count_nonzero(mask & (true_labels >= 0)))}
    recalls = np.full((2, len(LIMITS)), np.nan)
    if len(true_planes):
        recalls = recall_by_error(true_labels, true_planes, frame.depth_m, labels, planes,
                                  plane_depth(labels, planes, frame.intrinsics), mask)
    return numbers | {f'{kind} {limit}': float(value)
                      for kind, values in zip(('planes', 'pixels'), recalls, strict=True)
                      for limit, value in zip(LIMITS, values, strict=True)}


def segmentation_table(rows: Rows) -> str:
    """Return the Markdown table of the metrics without coefficients."""
    columns = {'SC': 4, 'VOI': 3, 'RI': 4, 'recall': 4, 'precision': 4, 'normal error': 2,
               'offset error': 1}
    lines = []
    for name, frames in rows.items():
        values = {key: np.array([one[key] for one in frames.values()])
                  for key in (*columns, 'CPU ms')}
        worst = list(frames)[int(values['SC'].argmin())]
        lines.append([name, len(frames), f'{values["SC"].min():.3f} ({worst})',
                      *(f'{known_mean(values[key]):.{digits}f}'
                        for key, digits in columns.items()),
                      f'{np.median(values["CPU ms"]):.1f}'])
    return table(('method', 'frames', 'worst SC (frame)', 'SC', 'VOI', 'RI', 'recall', 'precision',
                  'normal error (deg)', 'offset error (cm)', 'CPU ms'), lines)


def recall_table(rows: Rows) -> str:
    """Return the Markdown table of recalls by depth and angle: planes / pixels."""
    return table(('method', *LIMITS), [
        [name, *(' / '.join(f'{100 * pooled(frames, f"{kind} {limit}", f"true {kind}"):.1f}'
                            for kind in ('planes', 'pixels')) for limit in LIMITS)]
        for name, frames in rows.items()])


def pooled(frames: Mapping[int, Numbers], name: str, weight: str) -> float:
    """Return a recall over the planes or pixels of all frames together."""
    pairs = np.array([(numbers[name], numbers[weight]) for numbers in frames.values()
                      if numbers[weight] > 0]).reshape(-1, 2)
    return float(np.average(pairs[:, 0], weights=pairs[:, 1])) if len(pairs) else float('nan')
