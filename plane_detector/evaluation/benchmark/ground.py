# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Benchmark of ground, obstacles and drops on rendered terrain."""

from __future__ import annotations

import argparse
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from tqdm import tqdm

from plane_detector import Config, PlaneDetector
from plane_detector.config import DepthConfig, ScaleConfig
from plane_detector.evaluation.benchmark.options import add_shared, at_least_one
from plane_detector.evaluation.benchmark.report import emit, table
from plane_detector.evaluation.scenes.rendering import camera_rotation
from plane_detector.evaluation.scenes.terrain import (
    COURSES,
    Course,
    Kind,
    Terrain,
    View,
    flat,
    kerb,
    look,
    noisy,
    terrain,
)
from plane_detector.process import one_thread
from plane_detector.types import Detection

NOISES: tuple[float | str, ...] = (0.0, 0.001, 0.004, 'kinect')
# Smaller parts of a view are not judged.
MIN_PIXELS = 500
# A reported point belongs to an edge that is this near, metres and share of the distance.
NEAR_M, NEAR_SHARE = 0.1, 0.04
WITHIN_M, MIN_DROP_M = 3.0, 0.0999
GRAVITY_ERROR_DEG = 0.5
BOX_HEIGHTS_M = (0.03, 0.04, 0.05, 0.06, 0.07, 0.08, 0.1, 0.12, 0.15, 0.2)


# What is judged, and which share of ground is the worst one.
JUDGED = {Kind.FLOOR: min, Kind.RAMP: min, Kind.LANDING: min, Kind.UPPER: max, Kind.OBSTACLE: max}


@dataclass
class Tally:
    """Shares of ground of single views by what the pixels show, and counts of drops of all."""

    shares: dict[Kind, list[float]] = field(default_factory=lambda: defaultdict(list))
    counts: Counter[str] = field(default_factory=Counter)

    def __add__(self, other: Tally) -> Tally:
        both = Tally(defaultdict(list), self.counts + other.counts)
        for own in (self.shares, other.shares):
            for name, values in own.items():
                both.shares[name] += values
        return both


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('--views', type=at_least_one, default=10, help='of each kind of terrain')
    parser.add_argument('--only', choices=COURSES, help='one kind of terrain')
    add_shared(parser, '--first-seed')


def run(options: argparse.Namespace) -> None:
    """Print the tables."""
    seeds = range(options.first_seed, options.first_seed + options.views)
    names = [options.only] if options.only else list(COURSES)
    with one_thread():
        for noise in NOISES:
            tallies = {name: _tally(name, seeds, noise) for name in names}
            emit(f'### Noise {noise}, {len(seeds)} views of each kind, seeds {seeds[0]} to '
                 f'{seeds[-1]}', _shares(tallies))
        emit('### Smallest box that is found, and farthest drop of 10 cm', _limits(seeds))


def detect(view: Terrain, noise: float | str, seed: int, height_m: float = 0.0) -> Detection:
    """Detect in a view, with gravity as an IMU gives it."""
    rng = np.random.default_rng([seed, 1])
    config = Config(depth=DepthConfig(source='topic'), scale=ScaleConfig(camera_height=height_m))
    yaw, pitch, roll = rng.normal(0, GRAVITY_ERROR_DEG, 3)
    # The error about the axes of the camera.
    turn = camera_rotation(yaw, pitch, roll) @ camera_rotation(0, 0, 0).T
    return PlaneDetector(config).detect(view.scene.rgb, view.scene.intrinsics,
                                        noisy(view, noise, rng), turn @ view.scene.gravity_camera)


def _tally(name: str, seeds: Iterable[int], noise: float | str) -> Tally:
    tally = Tally()
    for seed in tqdm(seeds, f'{name}, {noise}', leave=False):
        view = terrain(name, np.random.default_rng([seed, *name.encode()]))
        judge(view, detect(view, noise, seed), tally)
    return tally


def judge(view: Terrain, found: Detection, tally: Tally) -> None:
    """Add a view to a tally."""
    for kind in JUDGED:
        pixels = view.kinds == kind
        if kind == Kind.OBSTACLE:
            pixels &= view.above_m > 0.05
        if pixels.sum() >= MIN_PIXELS:
            tally.shares[kind].append(float(found.ground[pixels].mean()))
    found_m = found.drops_m @ view.to_world.T + view.position_m
    tally.counts['frames'] += 1
    tally.counts['false'] += bool((_distances(found_m, view.edges_m) > _near(found_m)).any())
    must = (view.is_visible & (np.linalg.norm(view.edges_m[:, :2], axis=1) <= WITHIN_M)
            & (view.drops_m >= MIN_DROP_M))
    if must.sum() >= 10:  # 20 cm
        edge_m = view.edges_m[must]
        is_found = _distances(edge_m, found_m) <= _near(edge_m)
        tally.counts['edge points'] += len(is_found)
        tally.counts['edge points found'] += int(is_found.sum())
        tally.counts['frames with edge'] += 1
        tally.counts['frames found'] += bool(is_found.mean() > 0.5)


def _distances(points_m: np.ndarray, others_m: np.ndarray) -> np.ndarray:
    """Return the distance of each point from the nearest of the others."""
    if not len(points_m) or not len(others_m):
        return np.full(len(points_m), np.inf)
    return np.array([np.linalg.norm(others_m - point, axis=1).min() for point in points_m])


def _near(points_m: np.ndarray) -> np.ndarray:
    return NEAR_M + NEAR_SHARE * np.linalg.norm(points_m, axis=1)


def _shares(tallies: dict[str, Tally]) -> str:
    tallies = {**tallies, 'all': sum(tallies.values(), Tally())}
    return table(('terrain', 'own floor: mean, worst', 'ramp', 'behind the ramp',
                  'upper level', 'obstacle over 5 cm: mean, worst', 'drops found (views)',
                  '... of their length', 'views with a false drop'),
                 [[name, *_cells(tally)] for name, tally in tallies.items()])


def _cells(tally: Tally) -> list[str]:
    cells, counts = [], tally.counts
    for kind, worst in JUDGED.items():
        values = tally.shares[kind]
        cells.append(f'{np.mean(values):.3f}, {worst(values):.3f}' if values else '-')
    points = counts['edge points']
    return [*cells, f'{counts["frames found"]} of {counts["frames with edge"]}',
            f'{counts["edge points found"] / points:.3f}' if points else '-',
            f'{counts["false"]} of {counts["frames"]}']


def _limits(seeds: Sequence[int]) -> str:
    rows = []
    some = seeds[:5]
    for noise in NOISES:
        smallest = []
        for distance_m in (1.0, 2.0, 3.0):
            heights = [height for height in BOX_HEIGHTS_M
                       if np.mean([_finds_box(height, distance_m, noise, seed)
                                   for seed in some]) >= 0.8]
            smallest.append(f'{100 * min(heights):.0f} cm' if heights else 'none')
        farthest = [distance_m for distance_m in (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0)
                    if np.mean([_finds_kerb(distance_m, noise, seed) for seed in some]) >= 0.8]
        rows.append([str(noise), *smallest, f'{max(farthest):g} m' if farthest else 'none'])
    return table(('noise (1/m)', 'box at 1 m', '2 m', '3 m', 'drop of 10 cm'), rows)


def _finds_box(height_m: float, distance_m: float, noise: float | str, seed: int) -> bool:
    """Return whether half of what rises over the middle of a box of 20 cm is an obstacle."""
    rng = np.random.default_rng([seed, 2])
    course: Course = flat(rng, distance_m)
    course.add_box(0.0, distance_m + 0.1, np.array([0.2, 0.2, height_m]))
    view = look(course, View(1.0, 25.0), rng)
    of_box = ((view.kinds == Kind.OBSTACLE) & (view.above_m > height_m / 2)
              & (np.linalg.norm(view.points_m[..., :2] - [0, distance_m + 0.1], axis=2) < 0.3))
    return bool((~detect(view, noise, seed).ground[of_box]).mean() > 0.5)


def _finds_kerb(distance_m: float, noise: float | str, seed: int) -> bool:
    rng = np.random.default_rng([seed, 3])
    view = look(kerb(rng, distance_m, -1, 0.1), View(1.0, 15.0), rng)
    found_m = detect(view, noise, seed).drops_m @ view.to_world.T + view.position_m
    edge_m = view.edges_m[view.is_visible]
    return bool((_distances(edge_m, found_m) <= _near(edge_m)).sum() > 0.5 * len(edge_m) > 0)
