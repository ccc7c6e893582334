# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Benchmark on spheres, cylinders and cones among planes, with distractors of other shapes."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from tqdm import tqdm

from plane_detector import Config, PlaneDetector
from plane_detector.config import DepthConfig, ShapesConfig
from plane_detector.evaluation.benchmark.options import add_shared
from plane_detector.evaluation.benchmark.report import emit, table
from plane_detector.evaluation.metrics import score
from plane_detector.evaluation.peers import plane_array
from plane_detector.evaluation.scenes.noise import with_disparity_noise
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
        _report_planes(seeds)


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


@lru_cache(maxsize=64)
def _scene(seed: int) -> ShapeScene:
    return shape_scene(np.random.default_rng(seed))


def _noisy(seed: int, sigma: float) -> np.ndarray:
    depth_m = _scene(seed).scene.depth_m
    return with_disparity_noise(depth_m, sigma, np.random.default_rng([seed, 1])) if sigma else (
        depth_m)


def found_shapes(seed: int, sigma: float) -> list[ShapeGuess]:
    """Return the shapes that the package finds in a scene with its default settings."""
    depth_m = _noisy(seed, sigma)
    detection = PlaneDetector(CONFIG).detect(np.zeros((*depth_m.shape, 3), np.uint8),
                                             _scene(seed).scene.intrinsics, depth_m)
    return [ShapeGuess(shape.type, detection.labels == len(detection.planes) + k, shape.radius_m,
                       shape.axis) for k, shape in enumerate(detection.shapes)]


def _row(seeds: Sequence[int], sigma: float) -> list[str]:
    judged = [match(_scene(seed), found_shapes(seed, sigma))
              for seed in tqdm(seeds, f'{sigma:g}', leave=False)]
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


def _report_planes(seeds: Sequence[int]) -> None:
    """Print the effect of the search for shapes on the planes, and its time."""
    rows = []
    for sigma in SIGMAS:
        results = np.array([_planes(seed, sigma) for seed in tqdm(seeds, 'planes', leave=False)])
        means = np.nanmean(results, axis=0)
        extra_ms = results[:, 7] - results[:, 6]
        rows.append([f'{sigma:g}', *(f'{a:.3f} / {b:.3f}' for a, b in zip(
            means[0:6:2], means[1:6:2], strict=True)),
            f'{np.median(extra_ms):.1f} / {extra_ms.max():.1f} ms'])
    emit('### The planes without and with the search for shapes',
         table(('noise (1/m)', 'SC', 'recall', 'precision', 'time of the shapes, median / worst'),
               rows),
         'What is curved belongs to no plane, and its pixels count as that. Processor time of one '
         'thread.')


def _planes(seed: int, sigma: float) -> list[float]:
    scene = _scene(seed).scene
    depth_m, seen = _noisy(seed, sigma), np.isfinite(scene.depth_m)
    scores, times_ms = [], []
    for config in (replace(CONFIG, shapes=ShapesConfig()), CONFIG):
        start_s = time.thread_time()
        found = PlaneDetector(config).detect(scene.rgb, scene.intrinsics, depth_m)
        times_ms.append(1e3 * (time.thread_time() - start_s))
        labels = np.where(found.labels < len(found.planes), found.labels, -1)
        scores.append(score(scene.labels, scene.planes, labels, plane_array(found), seen))
    return [getattr(one, name) for name in ('segmentation_covering', 'recall', 'precision')
            for one in scores] + times_ms


def _iou(first: np.ndarray, second: np.ndarray) -> float:
    return float((first & second).sum() / max((first | second).sum(), 1))


def _angle_deg(guess: ShapeGuess, true: TrueShape) -> float:
    return float(np.degrees(np.arccos(min(abs(guess.axis @ true.axis), 1.0))))


def _errors(values: list[float], unit: str) -> str:
    return f'{np.median(values):.1f} / {max(values):.1f}{unit}' if values else '-'
