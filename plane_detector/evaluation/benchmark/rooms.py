# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Benchmark on random rendered rooms with exact ground truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from tqdm import tqdm

from plane_detector.config import Config
from plane_detector.evaluation.benchmark.tables import emit, table
from plane_detector.evaluation.datasets import Frame
from plane_detector.evaluation.metrics import (
    MIN_PIXELS,
    RECALL_ANGLES_DEG,
    RECALL_DEPTHS_M,
    Score,
    depth_recall,
    known_mean,
    normal_recall,
    overlap,
    score,
)
from plane_detector.evaluation.peers import Method, Ours
from plane_detector.evaluation.plane_geometry import plane_depth
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rooms import Scene, random_room
from plane_detector.evaluation.scenes.sensors import SENSORS
from plane_detector.pipeline import segment_planes

SIGMAS = (0.0, 0.0001, 0.0003, 0.001, 0.004, 0.01)
"""Standard deviations of the disparity noise, 1/m."""
HELD_OUT = 9000
"""Scenes from this seed on are for reporting only; they must not be used for tuning."""
SceneOfSeed = Callable[[int], Scene]
CONFIDENCE_EDGES = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 1.0)


@dataclass(frozen=True)
class RoomSet:
    """Rooms by their seeds; slow methods get the first ``slow_count`` of them."""

    name: str
    seeds: range
    slow_count: int

    def for_method(self, method: Method) -> range:
        """Return the seeds for a method."""
        return self.seeds[:self.slow_count] if method.slow else self.seeds


def room_sets(count: int, slow_count: int) -> tuple[RoomSet, RoomSet]:
    """Return the rooms used for tuning and the held-out ones."""
    return (RoomSet('tuning', range(count), slow_count),
            RoomSet('held-out', range(HELD_OUT, HELD_OUT + count), slow_count))


@lru_cache(maxsize=64)
def room(seed: int) -> Scene:
    """Return one room."""
    return random_room(np.random.default_rng(seed))


def noisy_depth(scene: Scene | Frame, noise: float | str, seed: int) -> np.ndarray:
    """Return a scene's depth with disparity noise or as a sensor sees it, the same for a seed."""
    rng = np.random.default_rng([seed, 1])
    if isinstance(noise, str):
        return SENSORS[noise](scene.depth_m, scene.intrinsics, rng)
    return with_disparity_noise(scene.depth_m, noise, rng) if noise else scene.depth_m


def report_rooms(methods: Sequence[Method], count: int, slow_count: int) -> None:
    """Print the tables of all rooms."""
    report_sets('Rendered rooms', room, methods, count, slow_count)
    report_ours(count)


def report_sets(title: str, scene_of: SceneOfSeed, methods: Sequence[Method], count: int,
                slow_count: int) -> None:
    """Print the tables of the scenes that a function makes from seeds."""
    for rooms in room_sets(count, slow_count):
        rows = [row(method, rooms.for_method(method), sigma, scene_of)
                for method in tqdm(methods, f'{title}, {rooms.name}', leave=False)
                if not method.absent for sigma in SIGMAS]
        emit(f'### {title}, {rooms.name} seeds {rooms.seeds[0]} to {rooms.seeds[-1]}',
             table(columns('rooms', 'seed'), rows))
    emit(f'Seeds up to {HELD_OUT - 1} were used for tuning, the others were not. Means over the '
         f'rooms; recall counts true planes of more than {MIN_PIXELS} pixels, both it and '
         'precision matches of IoU > 0.5; errors are medians over the matched planes of a room. '
         'Slow methods are tried on the first rooms only.')
    emit(*(f'{method.name}: absent, {method.absent}.' for method in methods if method.absent))


def columns(counted: str, named: str) -> tuple[str, ...]:
    """Return the header of a table of methods, with the names of its counts and of the worst."""
    return ('method', 'noise (1/m)', counted, 'SC', f'worst SC ({named})', 'VOI', 'RI', 'recall',
            'worst recall', 'precision', 'worst precision', 'normal error (deg)',
            'offset error (cm)')


def row(method: Method, seeds: Sequence[int], sigma: float, scene_of: SceneOfSeed) -> list[str]:
    """Return a row of the table: means over some rooms."""
    scores = [room_score(method, seed, sigma, scene_of) for seed in seeds]
    return [method.name, f'{sigma:g}', *score_cells(scores, seeds)]


def score_cells(scores: Sequence[Score], names: Sequence[object]) -> list[str]:
    """Return the cells after the second column: statistics of the scores of some images."""
    def column(name: str) -> np.ndarray:
        return np.array([getattr(one, name) for one in scores], float)

    covering, recall, precision = (
        column(name) for name in ('segmentation_covering', 'recall', 'precision'))
    cells = [str(len(scores)), f'{covering.mean():.3f}',
             f'{covering.min():.2f} ({names[covering.argmin()]})',
             f'{column("variation_of_information").mean():.2f}',
             f'{column("rand_index").mean():.3f}']
    for values in (recall, precision):
        cells += [f'{known_mean(values):.3f}', f'{np.nanmin(values, initial=1):.2f}']
    return [*cells, f'{known_mean(column("normal_error_deg")):.2f}',
            f'{100 * known_mean(column("offset_error_m")):.1f}']


def room_score(method: Method, seed: int, sigma: float, scene_of: SceneOfSeed) -> Score:
    """Score a method on one room."""
    scene = scene_of(seed)
    labels, planes = method(noisy_depth(scene, sigma, seed), scene.intrinsics)
    return score(scene.labels, scene.planes, labels, planes, np.isfinite(scene.depth_m))


def report_ours(count: int) -> None:
    """Print the measurements made only for our method, over the held-out rooms."""
    seeds = room_sets(count, 0)[1].seeds
    emit('### Ours on the held-out rooms: recall by depth error and by angle')
    rows = []
    for sigma in SIGMAS:
        found = [_recalls(seed, sigma) for seed in tqdm(seeds, 'recall', leave=False)]
        planes, pixels, angles = (np.mean([one[k] for one in found], axis=0) for k in range(3))
        rows.append([f'{sigma:g}', *(f'{a:.2f} / {b:.2f}' for a, b in
                                     zip(planes, pixels, strict=True)),
                     *(f'{a:.2f}' for a in angles)])
    emit(table(['noise (1/m)', *(f'{depth:g} m' for depth in RECALL_DEPTHS_M),
                *(f'{angle:g} deg' for angle in RECALL_ANGLES_DEG)], rows),
         'Planes / pixels of true planes of any size that a plane with IoU > 0.5 matches within '
         'that depth or angle.')
    report_confidence(seeds)


def _recalls(seed: int, sigma: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    scene = room(seed)
    labels, planes = Ours()(noisy_depth(scene, sigma, seed), scene.intrinsics)
    seen = np.isfinite(scene.depth_m)
    depth_m = plane_depth(labels, planes, scene.intrinsics)
    return (*depth_recall(scene.labels, scene.depth_m, labels, depth_m, seen),
            normal_recall(scene.labels, scene.planes, labels, planes, seen)[0])


def report_confidence(seeds: Sequence[int]) -> None:
    """Print the share of true planes for each range of confidence, over all noises."""
    pairs = np.array([pair for sigma in SIGMAS for seed in tqdm(seeds, 'confidence', leave=False)
                      for pair in _confidences(seed, sigma)]).reshape(-1, 2)
    emit('### Ours on the held-out rooms: what the confidence says', reliability(*pairs.T))


def reliability(confidence: np.ndarray, matched: np.ndarray) -> str:
    """Return a Markdown table: for each range of confidence (n,), the share of true planes."""
    rows = []
    for low, high in zip(CONFIDENCE_EDGES[:-1], CONFIDENCE_EDGES[1:], strict=True):
        inside = (confidence > low) & (confidence <= high)
        rows.append([f'{low:g} to {high:g}', str(inside.sum()),
                     *(f'{known_mean(values[inside].astype(float)):.2f}'
                       for values in (confidence, matched))])
    return table(('confidence', 'planes', 'mean confidence', 'share that match'), rows)


def _confidences(seed: int, sigma: float) -> Iterator[tuple[float, bool]]:
    """Yield the confidence of each plane and whether it matches a true one."""
    scene = room(seed)
    found = segment_planes(noisy_depth(scene, sigma, seed), scene.intrinsics, Config())
    shared = overlap(scene.labels, found.labels, np.isfinite(scene.depth_m))
    for plane, iou in zip(found.planes, shared.iou.T, strict=True):
        yield plane.confidence, bool((iou > 0.5).any())
