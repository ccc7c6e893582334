# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Run time on one thread, of our method and the others side by side.

The methods take turns, so that other load on the machine affects all of them equally. Points and
calibration are prepared for the other methods before the clock starts; ours is timed from the
depth image to the labels of all pixels and the measured planes.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np
from tqdm import tqdm

from plane_detector.evaluation.benchmark.report import (
    HELD_OUT,
    add_shared,
    at_least_one,
    emit,
    table,
)
from plane_detector.evaluation.datasets import frames
from plane_detector.evaluation.peers import Method, OpenCv, Ours, all_methods
from plane_detector.evaluation.scenes.rooms import random_room
from plane_detector.process import one_thread
from plane_detector.types import CameraIntrinsics

SIZES = ((320, 240), (640, 480), (1280, 720))
SLOW_REPEATS = 3
Case = tuple[np.ndarray, CameraIntrinsics]
"""Depth in metres and camera."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('--repeats', type=at_least_one, default=15, help='runs of all that is '
                        'timed')
    add_shared(parser, '--data')


def run(options: argparse.Namespace) -> None:
    """Print the tables of times; with real frames one more."""
    real: dict[str, list[Case]] = {}
    for frame in frames(options.data) if options.data.is_dir() else ():
        real.setdefault(frame.set_name, []).append((frame.depth_m, frame.intrinsics))
    sizes = {f'{width} x {height}': [_sized_room(seed, width, height)
                                     for seed in range(HELD_OUT, HELD_OUT + 3)]
             for width, height in SIZES}
    quick: list[Method] = [Ours(), OpenCv(0.03)]
    with one_thread():
        for title, methods, groups in (
                (f'Time at 640 x 480, clean room {HELD_OUT}', all_methods(),
                 {f'room {HELD_OUT}': sizes['640 x 480'][:1]}),
                ('Time on real frames, depth of the sensor', quick, real),
                ('Time by resolution, clean rooms', quick, sizes)):
            present, rows = [one for one in methods if not one.absent], []
            for name, cases in groups.items():
                ms = median_ms(present, cases, options.repeats)
                rows += [[name, len(cases), method.name, f'{np.median(own):.1f}',
                          f'{own.max():.1f}', f'{1e6 * np.median(own) / cases[0][0].size:.0f}',
                          f'{np.median(own) / np.median(ms[0]):.2f}']
                         for method, own in zip(present, ms, strict=True)]
            if rows:
                emit(f'### {title}', table(('images', 'n', 'method', 'median (ms)', 'worst',
                                            'ns a pixel', 'times ours'), rows))


def median_ms(methods: Sequence[Method], cases: Sequence[Case], repeats: int) -> np.ndarray:
    """
    Return the median times (methods, cases) of methods that take turns, in milliseconds.

    Each runs once more than is counted; slow ones run at most SLOW_REPEATS times.
    """
    taken = [[[] for _ in cases] for _ in methods]
    for turn in tqdm(range(repeats + 1), 'times', leave=False):
        for k, case in enumerate(cases):
            for m, method in enumerate(methods):
                if method.slow and turn >= SLOW_REPEATS:
                    continue
                prepared = method.prepare(*case)
                start = time.perf_counter()
                method.run(prepared)
                elapsed = time.perf_counter() - start
                if turn > 0 or method.slow:
                    taken[m][k].append(elapsed)
    return 1e3 * np.array([[np.median(case) for case in method] for method in taken])


def _sized_room(seed: int, width: int, height: int) -> Case:
    """Return a room seen by a camera of 525 px focal length at a width of 640."""
    focal_px = 525.0 * width / 640
    intrinsics = CameraIntrinsics(focal_px, focal_px, (width - 1) / 2, (height - 1) / 2, width,
                                  height)
    return random_room(np.random.default_rng(seed), intrinsics).depth_m, intrinsics
