# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Benchmark on spheres, cylinders and cones among planes, with distractors of other shapes."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from tqdm import tqdm

from plane_detector import Config, PlaneDetector
from plane_detector.config import DepthConfig, ShapesConfig
from plane_detector.evaluation.benchmark.report import add_shared, emit, table
from plane_detector.evaluation.benchmark.samples import noisy_depth
from plane_detector.evaluation.scenes.shapes import ShapeScene, TrueShape, shape_scene
from plane_detector.process import one_thread
from plane_detector.types import ShapeType

SIGMAS = (0.0, 0.001, 0.004)
MIN_PIXELS = 900
"""Smaller true shapes are not counted as missed."""
CONFIG = Config(depth=DepthConfig(source='topic'), shapes=ShapesConfig(types='all'))


@dataclass(frozen=True)
class ShapeGuess:
    """One shape found: radius 0 for a cone, axis 0 for a sphere; ``mask`` is (H, W) bool."""

    type: ShapeType
    mask: np.ndarray
    radius_m: float
    axis: np.ndarray


@dataclass(frozen=True)
class Judged:
    """Result for the shapes of one scene; errors are of matched shapes."""

    matched: tuple[ShapeType, ...]
    missed: tuple[ShapeType, ...]
    wrong: int
    radius_errors: tuple[float, ...]
    axis_errors_deg: tuple[float, ...]


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


def match(scene: ShapeScene, guesses: Sequence[ShapeGuess]) -> Judged:
    """Match guesses with the true shapes, one to one: IoU above 0.5 and the same type."""
    free, pairs, wrong = list(scene.shapes), [], 0
    for guess in guesses:
        best = max(free, key=lambda true: _iou(guess.mask, true.mask), default=None)
        if best is not None and best.type == guess.type and _iou(guess.mask, best.mask) > 0.5:
            pairs.append((guess, best))
            free = [true for true in free if true is not best]
        else:
            wrong += 1
    large = [(guess, true) for guess, true in pairs if true.mask.sum() >= MIN_PIXELS]
    return Judged(
        tuple(true.type for _, true in large),
        tuple(true.type for true in free if true.mask.sum() >= MIN_PIXELS), wrong,
        tuple(abs(guess.radius_m - true.radius_m) / true.radius_m for guess, true in large
              if true.radius_m),
        tuple(_angle_deg(guess, true) for guess, true in large if true.axis.any()))


def found_shapes(scene: ShapeScene, depth_m: np.ndarray) -> list[ShapeGuess]:
    """Return the shapes that the package finds in a scene with its default settings."""
    found = PlaneDetector(CONFIG).detect(np.zeros((*depth_m.shape, 3), np.uint8),
                                         scene.scene.intrinsics, depth_m)
    return [ShapeGuess(shape.type, found.labels == len(found.planes) + k, shape.radius_m,
                       shape.axis) for k, shape in enumerate(found.shapes)]


def _row(seeds: Sequence[int], sigma: float) -> list[str]:
    judged = []
    for seed in tqdm(seeds, f'{sigma:g}', leave=False):
        scene = shape_scene(np.random.default_rng(seed))
        judged.append(match(scene, found_shapes(scene, noisy_depth(scene.scene, sigma, seed))))
    matched = [kind for one in judged for kind in one.matched]
    missed = [kind for one in judged for kind in one.missed]
    wrong = sum(one.wrong for one in judged)
    found = len(matched) + wrong
    by_kind = [f'{matched.count(kind)} of {matched.count(kind) + missed.count(kind)}'
               for kind in ShapeType]
    return [f'{sigma:g}', str(len(seeds)), str(len(matched) + len(missed)),
            f'{len(matched) / max(len(matched) + len(missed), 1):.2f}', *by_kind,
            f'{len(matched) / found:.2f}' if found else '-',
            _errors([100 * e for one in judged for e in one.radius_errors], ' %'),
            _errors([e for one in judged for e in one.axis_errors_deg], ' deg')]


def _iou(first: np.ndarray, second: np.ndarray) -> float:
    return float((first & second).sum() / max((first | second).sum(), 1))


def _angle_deg(guess: ShapeGuess, true: TrueShape) -> float:
    return float(np.degrees(np.arccos(min(abs(guess.axis @ true.axis), 1.0))))


def _errors(values: list[float], unit: str) -> str:
    return f'{np.median(values):.1f} / {max(values):.1f}{unit}' if values else '-'
