# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Missed planes by their distance from the plane found instead, relative to the noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from tqdm import tqdm

from plane_detector.evaluation.benchmark.rooms import SIGMAS, SceneOfSeed, noisy_depth
from plane_detector.evaluation.benchmark.tables import emit, table
from plane_detector.evaluation.metrics import MIN_PIXELS, overlap
from plane_detector.evaluation.peers import Ours
from plane_detector.evaluation.plane_geometry import plane_depth
from plane_detector.evaluation.scenes.rooms import Scene

_EDGES = (0.0, 0.5, 1.0, 2.0, np.inf)


def report_misses(title: str, scene_of: SceneOfSeed, seeds: Sequence[int]) -> None:
    """Print the distance of missed planes from the planes that contain their pixels."""
    rows = []
    for sigma in SIGMAS[1:]:
        found = np.array([deviation for seed in tqdm(seeds, 'misses', leave=False)
                          for deviation in missed(scene_of(seed), sigma, seed)])
        counts = np.histogram(found[np.isfinite(found)], _EDGES)[0]
        rows.append([f'{sigma:g}', str(len(found)), *map(str, counts),
                     str(np.count_nonzero(~np.isfinite(found)))])
    emit(f'### {title}: what is missed',
         table(('noise (1/m)', 'planes missed', *(
             f'{low:g} to {high:g}' for low, high in zip(_EDGES[:-1], _EDGES[1:], strict=True)),
             'other'), rows),
         'Root mean square distance in 1/z, as a multiple of the noise, from the predicted plane '
         'that holds over half of the missed plane\'s pixels to the true one; other: no plane '
         'holds as many.')


def missed(scene: Scene, sigma: float, seed: int) -> Iterator[float]:
    """
    Yield the distance of each missed plane from the plane that contains its pixels.

    Parameters
    ----------
    scene : Scene
    sigma : float
        Standard deviation of 1/depth, 1/m.
    seed : int
        For the noise.

    Yields
    ------
    float
        In multiples of the noise; infinite if no plane contains more than half of its pixels.

    """
    labels, planes = Ours()(noisy_depth(scene, sigma, seed), scene.intrinsics)
    seen = np.isfinite(scene.depth_m)
    shared = overlap(scene.labels, labels, seen)
    pixels = shared.counts[:-1].sum(axis=1)
    for k in np.flatnonzero((pixels > MIN_PIXELS) & (shared.iou.max(axis=1, initial=0) <= 0.5)):
        taken_for = int(shared.counts[k].argmax())
        if taken_for == len(planes) or shared.counts[k, taken_for] <= pixels[k] / 2:
            yield np.inf
            continue
        everywhere = np.full(labels.shape, taken_for)
        there = seen & (scene.labels == k)
        error = 1 / scene.depth_m - 1 / plane_depth(everywhere, planes, scene.intrinsics)
        yield float(np.sqrt(np.mean(error[there] ** 2))) / sigma
