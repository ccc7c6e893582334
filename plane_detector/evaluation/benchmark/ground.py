# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Benchmark of ground, obstacles and drops on rendered terrain."""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Mapping, Sequence

import numpy as np
from tqdm import tqdm

from plane_detector import Config, PlaneDetector
from plane_detector._runtime.process import one_thread
from plane_detector.config import DepthConfig, ScaleConfig
from plane_detector.evaluation.benchmark.report import add_shared, at_least_one, emit, table
from plane_detector.evaluation.scenes.rendering import camera_rotation
from plane_detector.evaluation.scenes.terrain import (
    COURSES,
    Kind,
    Terrain,
    View,
    flat,
    kerb,
    look,
    noisy,
    terrain,
)
from plane_detector.types import Detection

NOISES: tuple[float | str, ...] = (0.0, 0.001, 0.004, 'kinect')
# Smaller parts of a view are not evaluated.
MIN_PIXELS = 500
# A reported point belongs to an edge within this distance, in metres and as a share of the
# distance.
NEAR_M, NEAR_SHARE = 0.1, 0.04
WITHIN_M, MIN_DROP_M = 3.0, 0.0999
GRAVITY_ERROR_DEG = 0.5
BOX_HEIGHTS_M = (0.03, 0.04, 0.05, 0.06, 0.07, 0.08, 0.1, 0.12, 0.15, 0.2)
KERB_DISTANCES_M = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0)
# What is evaluated, and whether the smallest or the largest share of ground is the worst.
JUDGED = {Kind.FLOOR: min, Kind.RAMP: min, Kind.LANDING: min, Kind.LOWER: min, Kind.UPPER: max,
          Kind.OBSTACLE: max}
# Views with a share on the wrong side of this, for ground or for what is not ground, are counted.
BAD_SHARE = 0.8
Judgements = Mapping[str, list[float]]
"""The numbers of :func:`measure` of all views."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('--views', type=at_least_one, default=24, help='of each kind of terrain')
    parser.add_argument('--only', choices=COURSES, help='one kind of terrain')
    add_shared(parser, '--first-seed')


def run(options: argparse.Namespace) -> None:
    """Print the tables."""
    seeds = range(options.first_seed, options.first_seed + options.views)
    names = [options.only] if options.only else list(COURSES)
    with one_thread():
        for noise in NOISES:
            judged: dict[str, Judgements] = {name: defaultdict(list) for name in names}
            for name, seed in tqdm([(name, seed) for name in names for seed in seeds],
                                   str(noise), leave=False):
                for key, number in measure(name, seed, noise).items():
                    judged[name][key].append(number)
            emit(f'### Noise {noise}, {len(seeds)} views of each kind, seeds {seeds[0]} to '
                 f'{seeds[-1]}', _shares(judged))
        emit('### Smallest box that is found, and farthest drop of 10 cm', _limits(seeds))


def detect(view: Terrain, noise: float | str, seed: int, height_m: float = 0.0) -> Detection:
    """Detect in a view, with gravity as from an IMU."""
    rng = np.random.default_rng([seed, 1])
    config = Config(depth=DepthConfig(source='topic'), scale=ScaleConfig(camera_height=height_m))
    yaw, pitch, roll = rng.normal(0, GRAVITY_ERROR_DEG, 3)
    # The error about the axes of the camera.
    turn = camera_rotation(yaw, pitch, roll) @ camera_rotation(0, 0, 0).T
    return PlaneDetector(config).detect(view.scene.rgb, view.scene.intrinsics,
                                        noisy(view, noise, rng), turn @ view.scene.gravity_camera)


def measure(name: str, seed: int, noise: float | str) -> dict[str, float]:
    """
    Return what is found in one view of a kind of terrain.

    The share of pixels classified as ground by what they show (a name of ``Kind`` in lower case),
    whether there is a ``false`` drop, and, if there is an edge that must be detected, the numbers
    of its points, all (``edge``) and ``found``.
    """
    view = terrain(name, np.random.default_rng([seed, *name.encode()]))
    return judge(view, detect(view, noise, seed))


def judge(view: Terrain, found: Detection) -> dict[str, float]:
    """Return the results for a view, see :func:`measure`."""
    judged: dict[str, float] = {}
    for kind in JUDGED:
        pixels = view.kinds == kind
        if kind == Kind.OBSTACLE:
            pixels &= view.above_m > 0.05
        if pixels.sum() >= MIN_PIXELS:
            judged[kind.name.lower()] = float(found.ground[pixels].mean())
    found_m = view.in_world(found.drops_m)
    judged['false'] = float((_distances(found_m, view.edges_m) > _near(found_m)).any())
    must = (view.is_visible & (np.linalg.norm(view.edges_m[:, :2], axis=1) <= WITHIN_M)
            & (view.drops_m >= MIN_DROP_M))
    if must.sum() >= 10:  # 20 cm
        edge_m = view.edges_m[must]
        judged['edge'] = len(edge_m)
        judged['found'] = int((_distances(edge_m, found_m) <= _near(edge_m)).sum())
    return judged


def _distances(points_m: np.ndarray, others_m: np.ndarray) -> np.ndarray:
    """Return the distance of each point from the nearest of the others."""
    if not len(points_m) or not len(others_m):
        return np.full(len(points_m), np.inf)
    return np.array([np.linalg.norm(others_m - point, axis=1).min() for point in points_m])


def _near(points_m: np.ndarray) -> np.ndarray:
    return NEAR_M + NEAR_SHARE * np.linalg.norm(points_m, axis=1)


def _shares(judged: dict[str, Judgements]) -> str:
    everything = {key: [value for one in judged.values() for value in one[key]]
                  for key in (*(kind.name.lower() for kind in JUDGED), 'false', 'edge', 'found')}
    return table(('terrain', f'own floor: mean, worst, views below {BAD_SHARE:g}', 'ramp',
                  'behind the ramp', 'lower level',
                  f'upper level: mean, worst, views above {1 - BAD_SHARE:.1g}',
                  'obstacle over 5 cm', 'drops found (views)', '... of their length',
                  'views with a false drop'),
                 [[name, *_cells(one)] for name, one in {**judged, 'all': everything}.items()])


def _cells(judged: Judgements) -> list[str]:
    edge, found = np.array(judged['edge']), np.array(judged['found'])
    shares = [(np.array(judged[kind.name.lower()]), worst) for kind, worst in JUDGED.items()]
    return [*(f'{of.mean():.3f}, {worst(of):.3f}, '
              f'{(of < BAD_SHARE if worst is min else of > 1 - BAD_SHARE).sum()} of {len(of)}'
              if of.size else '-' for of, worst in shares),
            f'{np.count_nonzero(2 * found > edge)} of {len(edge)}',
            f'{found.sum() / edge.sum():.3f}' if edge.size else '-',
            f'{sum(judged["false"]):.0f} of {len(judged["false"])}']


def _limits(seeds: Sequence[int]) -> str:
    rows = []
    for noise in NOISES:
        smallest = []
        for distance_m in (1.0, 2.0, 3.0):
            heights = [height_m for height_m in BOX_HEIGHTS_M
                       if np.mean([_finds_box(height_m, distance_m, noise, seed)
                                   for seed in seeds[:5]]) >= 0.8]
            smallest.append(f'{100 * min(heights):.0f} cm' if heights else 'none')
        farthest = [distance_m for distance_m in KERB_DISTANCES_M
                    if np.mean([_finds_kerb(distance_m, noise, seed)
                                for seed in seeds[:5]]) >= 0.8]
        rows.append([noise, *smallest, f'{max(farthest):g} m' if farthest else 'none'])
    return table(('noise (1/m)', 'box at 1 m', '2 m', '3 m', 'drop of 10 cm'), rows)


def _finds_box(height_m: float, distance_m: float, noise: float | str, seed: int) -> bool:
    """Return whether half of the middle of a box of 20 cm is an obstacle."""
    rng = np.random.default_rng([seed, 2])
    course = flat(rng, distance_m)
    course.add_box(0.0, distance_m + 0.1, np.array([0.2, 0.2, height_m]))
    view = look(course, View(1.0, 25.0), rng)
    of_box = ((view.kinds == Kind.OBSTACLE) & (view.above_m > height_m / 2)
              & (np.linalg.norm(view.points_m[..., :2] - [0, distance_m + 0.1], axis=2) < 0.3))
    return bool((~detect(view, noise, seed).ground[of_box]).mean() > 0.5)


def _finds_kerb(distance_m: float, noise: float | str, seed: int) -> bool:
    rng = np.random.default_rng([seed, 3])
    view = look(kerb(rng, distance_m, -1, 0.1), View(1.0, 15.0), rng)
    found_m = view.in_world(detect(view, noise, seed).drops_m)
    edge_m = view.edges_m[view.is_visible]
    return bool((_distances(edge_m, found_m) <= _near(edge_m)).sum() > 0.5 * len(edge_m) > 0)
