# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Accuracy and time of one method on one scene with one noise. Scenes run in parallel."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from tqdm import tqdm

from plane_detector.evaluation.benchmark.parallel import mapping
from plane_detector.evaluation.benchmark.rooms import (
    CURVED,
    curved_scene,
    furnished,
    judge_curved,
    noisy_depth,
    room,
)
from plane_detector.evaluation.datasets import UNKNOWN, LabelledFrame
from plane_detector.evaluation.metrics import MIN_PIXELS, labelled_score, overlap, score
from plane_detector.evaluation.peers import Method, Segments
from plane_detector.evaluation.scenes.rooms import Scene
from plane_detector.types import CameraIntrinsics

SIGMAS = (0.0, 0.0003, 0.001, 0.004, 0.01)
"""Standard deviations of the disparity noise, 1/m."""
CURVED_SIGMAS = (0.0, 0.004, 0.01)
Noise = float | str
"""Standard deviation of the disparity noise, 1/m, or a name of SENSORS."""
COUNTS = ('--rooms', '--living', '--curved')
"""Options of the numbers of scenes."""
_SCENES: dict[str, Callable[[int], Scene]] = {
    'rooms': room, 'lived-in rooms': furnished, 'curved': curved_scene}


@dataclass(frozen=True)
class Sample:
    """One method on one scene with one noise."""

    method: str
    kind: str  # rooms, lived-in rooms, curved or the name of a set of labelled frames
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
         frames: Iterable[LabelledFrame] = (), rendered: bool = True,
         sensors: Sequence[str] = ()) -> list[Job]:
    """
    Return the jobs of a run of the methods that are not absent.

    The counts are those of COUNTS. Slow methods only get that many rooms and lived-in
    rooms, and no frames. The noises are those of SIGMAS and CURVED_SIGMAS if ``rendered``,
    and the named sensors.
    """
    present = [method for method in methods if not method.absent]
    quick = [method for method in present if not method.slow]
    noises, curved = ((*(sigmas if rendered else ()), *sensors)
                      for sigmas in (SIGMAS, CURVED_SIGMAS))
    jobs = []
    for kind, count in (('rooms', counts['rooms']), ('lived-in rooms', counts['living'])):
        jobs += [Job(kind, first_seed + k, noises, present if k < slow else quick)
                 for k in range(count)]
    count = min(counts['curved'], len(CURVED))
    jobs += [Job('curved', int(k), curved, quick)
             for k in np.linspace(0, len(CURVED) - 1, count).round()]
    return jobs + [Job(frame.set_name, frame, (0.0,), quick) for frame in frames]


def run_jobs(jobs: Sequence[Job], processes: int) -> list[Sample]:
    """Run all jobs on several processes with one thread each; results are in order."""
    found: list[Sample] = []
    with mapping(processes) as apply:
        for samples in tqdm(apply(run_job, jobs), 'scenes', total=len(jobs), leave=False):
            found += samples
    return found


def run_job(job: Job) -> list[Sample]:
    """Run all methods of a job with all its noises."""
    if isinstance(job.scene, LabelledFrame):
        return [_on_labels(method, job.scene) for method in job.methods]
    scene = _SCENES[job.kind](job.scene)
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
    on_planes = seen & (scene.labels >= 0)
    numbers = {'SC': result.segmentation_covering, 'recall': result.recall,
               'precision': result.precision,
               'unlabelled': float((labels[on_planes] < 0).mean())}
    if kind == 'curved':
        numbers['curved'], numbers['IoU'] = judge_curved(labels, scene)
    shared = overlap(scene.labels, labels, seen)
    pixels = shared.counts[:-1].sum(axis=1)
    large = pixels > MIN_PIXELS
    return Sample(method.name, kind, str(seed), noise, cpu_ms, numbers,
                  pixels[large] / labels.size, (shared.iou[large] > 0.5).any(axis=1))


def _on_labels(method: Method, frame: LabelledFrame) -> Sample:
    (labels, _), cpu_ms = timed(method, frame.depth_m, frame.intrinsics)
    return Sample(method.name, frame.set_name, frame.name, 0.0, cpu_ms,
                  labelled_numbers(frame, labels))


def labelled_numbers(frame: LabelledFrame, labels: np.ndarray) -> dict[str, float]:
    """Return the metrics of predicted labels (H, W) on planes labelled by hand."""
    known = (frame.labels != UNKNOWN) & np.isfinite(frame.depth_m)
    score = labelled_score(np.maximum(frame.labels, -1), labels, known)
    return {'SC': score.segmentation_covering, 'recall': score.recall, 'pieces': score.pieces,
            'merged': score.merged, 'unlabelled': score.unlabelled}
