# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Benchmark on curved surfaces: columns, pipes and balls in a room."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np

from plane_detector.evaluation.benchmark.rooms import SIGMAS, noisy_depth
from plane_detector.evaluation.benchmark.tables import emit, table
from plane_detector.evaluation.metrics import MIN_PIXELS, overlap
from plane_detector.evaluation.peers import Method
from plane_detector.evaluation.scenes.rendering import VGA, Rectangle
from plane_detector.evaluation.scenes.rooms import Scene, camera_rotation, render
from plane_detector.evaluation.scenes.surfaces import bar, cone, ellipsoid

RADII_M = (0.25, 0.4, 0.7, 1.2)
ANGLES_DEG = ((0, 0, 0), (0, -15, 4), (10, 10, 0))
"""Yaw, pitch and roll of the camera."""
_FRONT_M, _WALL_M, _CAMERA_HEIGHT_M = 2.0, 4.0, 1.2


KINDS = ('column', 'pipe', 'ball')
CURVED = tuple(product(RADII_M, ANGLES_DEG, KINDS))
"""Content of each scene."""


def curved_scenes() -> Iterator[Scene]:
    """Yield all scenes."""
    return map(curved_scene, range(len(CURVED)))


def curved_scene(index: int) -> Scene:
    """Return a wall and a floor with one of CURVED in front of them."""
    radius_m, angles_deg, kind = CURVED[index]
    vectors = [([-50, _WALL_M, -50], [100, 0, 0], [0, 0, 100]),
               ([-9, -1, -_CAMERA_HEIGHT_M], [18, 0, 0], [0, 9, 0])]
    room = [Rectangle(*(np.array(vector, float) for vector in one)) for one in vectors]
    away_m = _FRONT_M + radius_m
    if kind == 'column':
        thing = cone(radius_m, radius_m, -3, 3).at(0, away_m)
    elif kind == 'pipe':
        thing = bar((-4, away_m, -0.3), (4, away_m, -0.3), radius_m)
    else:
        thing = ellipsoid(radius_m, radius_m).at(0, away_m)
    return render(room, camera_rotation(*angles_deg), np.zeros(3), VGA,
                  np.random.default_rng(0), thing.curved_pieces())


def report_curved(methods: Sequence[Method]) -> None:
    """Print the share of curved surfaces that each quick method labels as planes."""
    scenes = list(curved_scenes())
    rows = []
    for method, sigma in product(methods, SIGMAS):
        if method.absent or method.slow:
            continue
        found = np.array([judge(method, scene, sigma, seed) for seed, scene in enumerate(scenes)])
        rows.append([method.name, f'{sigma:g}', str(len(scenes)), f'{found[:, 0].mean():.2f}',
                     f'{found[:, 0].max():.2f}', f'{np.nanmean(found[:, 1]):.3f}',
                     f'{np.nanmin(found[:, 1]):.2f}'])
    emit('### Columns, pipes and balls in front of a wall',
         table(('method', 'noise (1/m)', 'scenes', 'taken for planes', 'worst', 'IoU of planes',
                'worst IoU'), rows),
         'Share of the pixels on the curved thing that have a label, and the least IoU of a true '
         f'plane over {MIN_PIXELS} pixels with a predicted one: means over the scenes.')


def judge(method: Method, scene: Scene, sigma: float, seed: int) -> tuple[float, float]:
    """Run a method on a scene; return the result of :func:`judge_labels`."""
    return judge_labels(method(noisy_depth(scene, sigma, seed), scene.intrinsics)[0], scene)


def judge_labels(labels: np.ndarray, scene: Scene) -> tuple[float, float]:
    """Return the labelled share of the curved pixels, and the lowest IoU of a large true plane."""
    seen = np.isfinite(scene.depth_m)
    curved = seen & (scene.labels < 0)
    shared = overlap(scene.labels, labels, seen)
    large = shared.counts[:-1].sum(axis=1) > MIN_PIXELS
    best = shared.iou[large].max(axis=1, initial=0)
    return float((labels[curved] >= 0).mean()), float(best.min(initial=1))
