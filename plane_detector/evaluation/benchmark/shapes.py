# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Benchmark on spheres, cylinders and cones among planes, with distractors of other shapes."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from tqdm import tqdm

from plane_detector import Config, PlaneDetector
from plane_detector._runtime.process import one_thread
from plane_detector.config import DepthConfig, ShapesConfig
from plane_detector.evaluation.benchmark.report import add_shared, emit, table
from plane_detector.evaluation.benchmark.samples import noisy_depth
from plane_detector.evaluation.scenes.shapes import SeenShape, ShapeScene, shape_scene
from plane_detector.types import ShapeType

SIGMAS = (0.0, 0.001, 0.004)
MIN_PIXELS = 900
"""Smaller true shapes are not counted as missed."""
CONFIG = Config(depth=DepthConfig(source='topic'), shapes=ShapesConfig(types='all'))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_shared(parser, '--scenes', '--first-seed', scenes=40)


def run(options: argparse.Namespace) -> None:
    """Print the tables."""
    seeds = range(options.first_seed, options.first_seed + options.scenes)
    with one_thread():
        rows = [_row(seeds, sigma) for sigma in SIGMAS]
        emit(f'### Spheres, cylinders and cones, scenes {seeds[0]} to {seeds[-1]}',
             table(('noise (1/m)', 'scenes', 'shapes', 'recall', 'spheres', 'cylinders',
                    'cones', 'precision', 'radius error, median / worst',
                    'axis error, median / worst'), rows),
             f'Recall counts true shapes of at least {MIN_PIXELS} pixels; a match has IoU > 0.5 '
             'and the right type. Half of the scenes hold a box, an ellipsoid, a curtain or a '
             'torus, which are none of these.')


def match(scene: ShapeScene, found: Sequence[SeenShape]) -> tuple[
        list[tuple[SeenShape, SeenShape]], list[SeenShape], int]:
    """
    Match shapes with the true ones, one to one: IoU above 0.5 and the same type.

    Returns the pairs of a found and a large true shape, the large true ones that were missed, and
    the number of shapes that match none.
    """
    free, pairs, wrong = list(scene.shapes), [], 0
    for shape in found:
        best = max(free, key=lambda true: _iou(shape.mask, true.mask), default=None)
        if best is not None and best.type == shape.type and _iou(shape.mask, best.mask) > 0.5:
            pairs.append((shape, best))
            free = [true for true in free if true is not best]
        else:
            wrong += 1
    return ([(shape, true) for shape, true in pairs if true.mask.sum() >= MIN_PIXELS],
            [true for true in free if true.mask.sum() >= MIN_PIXELS], wrong)


def found_shapes(scene: ShapeScene, depth_m: np.ndarray) -> list[SeenShape]:
    """Return the shapes that the package finds in a scene with its default settings."""
    found = PlaneDetector(CONFIG).detect(np.zeros((*depth_m.shape, 3), np.uint8),
                                         scene.scene.intrinsics, depth_m)
    return [SeenShape(shape.type, shape.position_m, shape.axis, shape.radius_m,
                      shape.half_angle_rad, found.shape_labels == k)
            for k, shape in enumerate(found.shapes)]


def _row(seeds: Sequence[int], sigma: float) -> list[str]:
    pairs, missed, wrong = [], [], 0
    for seed in tqdm(seeds, f'{sigma:g}', leave=False):
        scene = shape_scene(np.random.default_rng(seed))
        judged = match(scene, found_shapes(scene, noisy_depth(scene.scene, sigma, seed)))
        pairs, missed, wrong = pairs + judged[0], missed + judged[1], wrong + judged[2]
    matched = [true.type for _, true in pairs]
    asked = matched + [true.type for true in missed]
    return [f'{sigma:g}', str(len(seeds)), str(len(asked)),
            f'{len(matched) / max(len(asked), 1):.2f}',
            *(f'{matched.count(kind)} of {asked.count(kind)}' for kind in ShapeType),
            f'{len(matched) / (len(matched) + wrong):.2f}' if matched or wrong else '-',
            _errors([100 * abs(shape.radius_m / true.radius_m - 1) for shape, true in pairs
                     if true.radius_m], ' %'),
            _errors([np.degrees(np.arccos(min(abs(shape.axis @ true.axis), 1.0)))
                     for shape, true in pairs if true.axis.any()], ' deg')]


def _iou(first: np.ndarray, second: np.ndarray) -> float:
    return float((first & second).sum() / max((first | second).sum(), 1))


def _errors(values: list[float], unit: str) -> str:
    return f'{np.median(values):.1f} / {max(values):.1f}{unit}' if values else '-'
