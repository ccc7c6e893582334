# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Accuracy and time of methods on scenes given by their seeds, at each noise. Runs in parallel."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import product

import numpy as np

from plane_detector.evaluation.benchmark.report import in_parallel
from plane_detector.evaluation.datasets import UNKNOWN, LabelledFrame
from plane_detector.evaluation.metrics import MIN_PIXELS, labelled_score, overlap, score
from plane_detector.evaluation.peers import Method, Segments
from plane_detector.evaluation.scenes.living_rooms import living_room
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rendering import (
    VGA,
    Scene,
    camera_rotation,
    rectangle,
    render,
)
from plane_detector.evaluation.scenes.rooms import random_room
from plane_detector.evaluation.scenes.sensors import SENSORS
from plane_detector.evaluation.scenes.surfaces import bar, cone, ellipsoid
from plane_detector.types import CameraIntrinsics

SIGMAS, CURVED_SIGMAS = (0.0, 0.0003, 0.001, 0.004, 0.01), (0.0, 0.004, 0.01)
"""Standard deviations of the disparity noise, 1/m."""
Noise = float | str
"""Standard deviation of the disparity noise, 1/m, or a name of SENSORS."""
COUNTS = ('--rooms', '--living', '--curved')
"""Options of the numbers of scenes."""
CURVED = tuple(product((0.25, 0.4, 0.7, 1.2), ((0, 0, 0), (0, -15, 4), (10, 10, 0)),
                       ('column', 'pipe', 'ball')))
"""Each curved scene: radius in metres; yaw, pitch, roll of the camera; the object."""


@lru_cache(maxsize=64)
def room(seed: int) -> Scene:
    """Return one room of boxes."""
    return random_room(np.random.default_rng(seed))


@lru_cache(maxsize=64)
def furnished(seed: int) -> Scene:
    """Return one lived-in room."""
    return living_room(np.random.default_rng(seed))


def curved_scene(index: int) -> Scene:
    """Return a wall and a floor with one of CURVED in front of them."""
    radius_m, angles_deg, kind = CURVED[index]
    away_m = 2.0 + radius_m
    thing = {'column': cone(radius_m, radius_m, -3, 3).at(0, away_m),
             'pipe': bar((-4, away_m, -0.3), (4, away_m, -0.3), radius_m),
             'ball': ellipsoid(radius_m, radius_m).at(0, away_m)}[kind]
    return render([rectangle([-50, 4, -50], [100, 0, 0], [0, 0, 100]),
                   rectangle([-9, -1, -1.2], [18, 0, 0], [0, 9, 0])],
                  camera_rotation(*angles_deg), np.zeros(3), VGA, np.random.default_rng(0),
                  thing.curved_pieces())


SCENES: dict[str, Callable[[int], Scene]] = {
    'rooms': room, 'lived-in rooms': furnished, 'curved': curved_scene}


def noisy_depth(scene: Scene, noise: Noise, seed: int) -> np.ndarray:
    """Return a scene's depth with disparity noise or as from a sensor, fixed by the seed."""
    rng = np.random.default_rng([seed, 1])
    if isinstance(noise, str):
        return SENSORS[noise](scene.depth_m, scene.intrinsics, rng)
    return with_disparity_noise(scene.depth_m, noise, rng) if noise else scene.depth_m


@dataclass(frozen=True)
class Sample:
    """One method on one scene with one noise."""

    method: str
    kind: str  # one of SCENES or the name of a set of labelled frames
    scene: str  # seed or name of the frame
    noise: Noise
    cpu_ms: float  # time on one core; for a quick method the faster of two runs
    numbers: dict[str, float]  # by metric; NaN if undefined
    # (n,) of each true plane over MIN_PIXELS: share of the image, and whether it was found
    plane_shares: np.ndarray = field(default_factory=lambda: np.zeros(0))
    found: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))


@dataclass(frozen=True)
class Job:
    """One scene, given by its seed or as a frame, and the methods to run on it."""

    kind: str
    scene: int | LabelledFrame
    noises: Sequence[Noise]
    methods: Sequence[Method]


def plan(methods: Sequence[Method], counts: dict[str, int], first_seed: int, slow: int,
         frames: Iterable[LabelledFrame] = ()) -> list[Job]:
    """
    Return the jobs of a run of the methods that are not absent.

    The counts are those of COUNTS. Slow methods only get that many rooms and lived-in
    rooms, and no frames. The noises are those of SIGMAS or CURVED_SIGMAS, and all SENSORS.
    """
    present = [method for method in methods if not method.absent]
    quick = [method for method in present if not method.slow]
    noises, curved = (*SIGMAS, *SENSORS), (*CURVED_SIGMAS, *SENSORS)
    jobs = [Job(kind, first_seed + k, noises, present if k < slow else quick)
            for kind, name in (('rooms', 'rooms'), ('lived-in rooms', 'living'))
            for k in range(counts[name])]
    spread = np.linspace(0, len(CURVED) - 1, min(counts['curved'], len(CURVED))).round()
    return [*jobs, *(Job('curved', int(k), curved, quick) for k in spread),
            *(Job(frame.set_name, frame, (0.0,), quick) for frame in frames)]


def run_jobs(jobs: Sequence[Job], processes: int) -> list[Sample]:
    """Run all jobs on several processes with one thread each; results are in order."""
    return [sample for samples in in_parallel(run_job, jobs, processes, 'scenes')
            for sample in samples]


def run_job(job: Job) -> list[Sample]:
    """Run all methods of a job with all its noises."""
    if isinstance(job.scene, LabelledFrame):
        return [_on_labels(method, job.scene) for method in job.methods]
    scene = SCENES[job.kind](job.scene)
    return [_on_scene(method, job.kind, scene, job.scene, noise)
            for noise in job.noises for method in job.methods]


def timed(method: Method, depth_m: np.ndarray,
          intrinsics: CameraIntrinsics) -> tuple[Segments, float]:
    """Return the result of a method, and its milliseconds on one core."""
    taken_s = []
    for _ in range(1 if method.slow else 2):
        prepared = method.prepare(depth_m, intrinsics)
        start_s = time.process_time()
        raw = method.run(prepared)
        taken_s.append(time.process_time() - start_s)
    return method.result(raw), 1e3 * min(taken_s)


def _on_scene(method: Method, kind: str, scene: Scene, seed: int, noise: Noise) -> Sample:
    (labels, planes), cpu_ms = timed(method, noisy_depth(scene, noise, seed), scene.intrinsics)
    seen = np.isfinite(scene.depth_m)
    result = score(scene.labels, scene.planes, labels, planes, seen)
    numbers = {'SC': result.segmentation_covering, 'recall': result.recall,
               'precision': result.precision,
               'unlabelled': float((labels[seen & (scene.labels >= 0)] < 0).mean())}
    shared = overlap(scene.labels, labels, seen)
    pixels = shared.counts[:-1].sum(axis=1)
    large = pixels > MIN_PIXELS
    if kind == 'curved':
        numbers['curved'] = float((labels[seen & (scene.labels < 0)] >= 0).mean())
        numbers['IoU'] = float(shared.iou[large].max(axis=1, initial=0).min(initial=1))
    return Sample(method.name, kind, str(seed), noise, cpu_ms, numbers,
                  pixels[large] / labels.size, (shared.iou[large] > 0.5).any(axis=1))


def _on_labels(method: Method, frame: LabelledFrame) -> Sample:
    (labels, _), cpu_ms = timed(method, frame.depth_m, frame.intrinsics)
    return Sample(method.name, frame.set_name, frame.name, 0.0, cpu_ms,
                  labelled_numbers(frame, labels))


def labelled_numbers(frame: LabelledFrame, labels: np.ndarray) -> dict[str, float]:
    """Return the metrics of predicted labels (H, W) on planes labelled by hand."""
    known = (frame.labels != UNKNOWN) & np.isfinite(frame.depth_m)
    return labelled_score(np.maximum(frame.labels, -1), labels, known)
