# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""One frame of NYU Depth V2: ground truth, and the results of each method and depth."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from plane_detector.config import Config, DepthConfig, ScaleConfig, TrackingConfig
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.evaluation.annotated_planes import annotated_planes
from plane_detector.evaluation.benchmark.label_scores import Numbers, Truth, numbers_of
from plane_detector.evaluation.benchmark.samples import timed
from plane_detector.evaluation.label_folder import (
    label_files,
    planes_of_frame,
    read_annotation,
    read_labels,
    read_plane_table,
    write_labels,
)
from plane_detector.evaluation.nyu_depth import COLUMNS, INTRINSICS, ROWS, NyuDepth, NyuFrame
from plane_detector.evaluation.peers import (
    OpenCv,
    Ours,
    Paper,
    PlainRansac,
    Segments,
    plane_array,
    relabelled,
)
from plane_detector.evaluation.plane_geometry import fit_planes
from plane_detector.pipeline import PlaneDetector, segment_planes
from plane_detector.types import CameraIntrinsics

SENSOR, NETWORK = 'sensor', 'network'
ANNOTATIONS = 'annotations'
OURS = 'ours'
METHODS = {OURS: Ours, 'paper': Paper, 'ransac': PlainRansac, 'opencv': lambda: OpenCv(0.03)}


@dataclass(frozen=True)
class Task:
    """
    Settings for all frames and processes.

    Attributes
    ----------
    path : Path
        nyu_depth_v2_labeled.mat.
    depth : str
        ``raw`` or ``filled``.
    truth : str
        ``annotations``, ``sensor`` or a folder of label images.
    methods : tuple of str
        Keys of METHODS.
    model : str
        Depth network; empty: the sensor's depth only.
    outside : tuple of (str, Path)
        Name and folder of label images of each outside method.
    write_to : Path, optional
        Folder for the labels of every method, each in a subfolder.

    """

    path: Path
    depth: str = 'raw'
    truth: str = ANNOTATIONS
    methods: tuple[str, ...] = tuple(METHODS)
    model: str = ''
    outside: tuple[tuple[str, Path], ...] = ()
    write_to: Path | None = None


@dataclass(frozen=True)
class FrameResult:
    """Metrics of every method on a frame, by name of the row, and CPU milliseconds."""

    number: int
    rows: dict[str, Numbers]
    cpu_ms: dict[str, float]


def evaluate(task: Task, number: int) -> FrameResult:
    """Run all methods on a frame and score them."""
    frame = opened(task.path).frame(number, task.depth)
    truth = true_planes(task, frame)
    rows: dict[str, Numbers] = {}
    cpu_ms: dict[str, float] = {}
    for name, segments, taken_ms in segmentations(task, frame):
        rows[name], cpu_ms[name] = numbers_of(truth, *segments), taken_ms
        if task.write_to:
            labels, planes = segments
            folder = re.sub(r'\W+', '_', name)
            write_labels(task.write_to / folder, number, with_border(labels), planes)
    for name, folder in task.outside:
        segments = outside_segments(folder, frame)
        if segments is not None:
            rows[name] = numbers_of(truth, *segments)
    return FrameResult(number, rows, cpu_ms)


def segmentations(task: Task, frame: NyuFrame) -> list[tuple[str, Segments, float]]:
    """Return name, planes and CPU milliseconds of every method on the depth of each source."""
    methods = {name: METHODS[name]() for name in task.methods}
    present = {name: method for name, method in methods.items() if not method.absent}
    found = [(f'{method.name}, {SENSOR}', *timed(method, frame.depth_m, frame.intrinsics))
             for method in present.values()]
    if task.model:
        detection = _detector(task.model).detect(frame.rgb, frame.intrinsics,
                                                 *_sensor_for_scale(task.model, frame))
        for name, method in present.items():
            # Ours is the whole pipeline; its time would include that of the network.
            result = (((detection.labels, plane_array(detection)), float('nan'))
                      if name == OURS else timed(method, detection.depth_m, frame.intrinsics))
            found.append((f'{method.name}, {NETWORK}', *result))
    return found


def true_planes(task: Task, frame: NyuFrame) -> Truth:
    """
    Return the true planes of a frame.

    Raises
    ------
    ValueError
        Annotations are requested, but the file has none.

    """
    if task.truth == ANNOTATIONS:
        if not frame.segments.any() and not opened(task.path).has_annotations:
            raise ValueError(f'{task.path} has no labels and instances: use --truth sensor, or a '
                             'folder of label images')
        labels, planes = annotated_planes(frame.segments, frame.depth_m, frame.intrinsics,
                                          np.random.default_rng(frame.number))
    elif task.truth == SENSOR:
        found = segment_planes(frame.depth_m, frame.intrinsics)
        labels, planes = found.labels, plane_array(found)
    else:
        segments = outside_segments(Path(task.truth), frame)
        if segments is None:
            raise ValueError(f'{task.truth} has no label image of frame {frame.number}')
        labels, planes = segments
    return Truth(labels, planes, frame.depth_m, frame.intrinsics)


def outside_segments(folder: Path, frame: NyuFrame) -> Segments | None:
    """
    Return the planes found by an outside method in a frame; None if it has no result.

    The label image may show the frame with or without its border, at any resolution. Without a
    table, the planes are fitted to the sensor's depth.
    """
    files, table = _folder(folder)
    if frame.number not in files:
        return None
    values = _without_border(files[frame.number], frame.intrinsics)
    labels = relabelled(values, values > 0)
    if not table:
        return labels, fit_planes(labels, frame.depth_m, frame.intrinsics)
    return labels, planes_of_frame(table, frame.number, np.unique(values[values > 0]))


def _without_border(path: Path, cut: CameraIntrinsics) -> np.ndarray:
    if path.suffix == '.npz':
        return read_annotation(path, (cut.height, cut.width))
    try:
        return read_labels(path, (INTRINSICS.height, INTRINSICS.width))[ROWS, COLUMNS]
    except ValueError:
        return read_labels(path, (cut.height, cut.width))


def with_border(labels: np.ndarray) -> np.ndarray:
    """Return labels (H, W) of a frame without its border at full size, -1 in the border."""
    whole = np.full((INTRINSICS.height, INTRINSICS.width), -1, np.int32)
    whole[ROWS, COLUMNS] = labels
    return whole


# Opened once per process.
@lru_cache(maxsize=1)
def opened(path: Path) -> NyuDepth:
    """Return the opened file."""
    return NyuDepth(path)


@lru_cache(maxsize=8)
def _folder(folder: Path) -> tuple[dict[int, Path], dict[tuple[int, int], np.ndarray]]:
    return label_files(folder), read_plane_table(folder)


@lru_cache(maxsize=1)
def _detector(model: str) -> PlaneDetector:
    estimate = DepthEstimator(DepthConfig(model=model))
    method = 'depth_topic' if estimate.output == 'relative_disparity' else 'metric'
    return PlaneDetector(Config(scale=ScaleConfig(method=method),
                                tracking=TrackingConfig(enabled=False)), estimate)


def _sensor_for_scale(model: str, frame: NyuFrame) -> Sequence[np.ndarray]:
    """Reset the pipeline; give a relative network the sensor's depth, which fixes the scale."""
    detector = _detector(model)
    detector.reset()
    return [frame.depth_m] if detector.config.scale.method == 'depth_topic' else []
