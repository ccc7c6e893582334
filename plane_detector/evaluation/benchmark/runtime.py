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

from plane_detector.evaluation.benchmark import options as shared
from plane_detector.evaluation.benchmark.rooms import HELD_OUT, room
from plane_detector.evaluation.benchmark.tables import emit, table
from plane_detector.evaluation.datasets import Frame, frames
from plane_detector.evaluation.peers import Method, OpenCv, Ours, all_methods
from plane_detector.evaluation.scenes.rooms import Scene, random_room
from plane_detector.process import one_thread
from plane_detector.types import CameraIntrinsics

REPEATS = 15
SIZES = ((320, 240), (640, 480), (1280, 720))
SLOW_REPEATS = 3

Case = tuple[np.ndarray, CameraIntrinsics]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('--repeats', type=shared.at_least_one, default=REPEATS,
                        help='runs of everything timed')
    shared.add_data(parser)


def run(options: argparse.Namespace) -> None:
    """Print the tables of times; with real frames one more."""
    present = [method for method in all_methods() if not method.absent]
    found = list(frames(options.data)) if options.data.is_dir() else []
    with one_thread():
        _report_peers(present, options.repeats)
        _report_real(present, options.repeats, found)
        _report_sizes(present, options.repeats)


def median_ms(methods: Sequence[Method], cases: Sequence[Case], repeats: int) -> np.ndarray:
    """
    Time methods in turns.

    Parameters
    ----------
    methods : sequence of Method
        Slow ones run at most SLOW_REPEATS times.
    cases : sequence of (depth_m, intrinsics)
    repeats : int
        Runs of every method on every case, after one that is not counted.

    Returns
    -------
    (methods, cases) float64
        Median milliseconds.

    """
    taken = [[[] for _ in cases] for _ in methods]
    for turn in tqdm(range(repeats + 1), 'times', leave=False):
        for k, (depth_m, intrinsics) in enumerate(cases):
            for m, method in enumerate(methods):
                if method.slow and turn >= SLOW_REPEATS:
                    continue
                prepared = method.prepare(depth_m, intrinsics)
                start = time.perf_counter()
                method.run(prepared)
                elapsed = time.perf_counter() - start
                if turn > 0 or method.slow:
                    taken[m][k].append(elapsed)
    return 1e3 * np.array([[np.median(case) for case in method] for method in taken])


def _report_peers(methods: Sequence[Method], repeats: int) -> None:
    scene = room(HELD_OUT)
    ms = median_ms(methods, [(scene.depth_m, scene.intrinsics)], repeats)[:, 0]
    emit(f'### Time at 640 x 480, one thread, clean room {HELD_OUT}',
         table(('method', 'median (ms)', 'times ours'),
               [[method.name, f'{taken:.1f}', f'{taken / ms[0]:.2f}']
                for method, taken in zip(methods, ms, strict=True)]),
         'Points are made ready for the peers before the clock starts; ours starts from depth.')


def _quick(methods: Sequence[Method]) -> list[Method]:
    """Return ours and findPlanes with its first threshold."""
    peers = [method for method in methods if isinstance(method, OpenCv)]
    return [Ours(), *peers[:1]]


def _report_real(methods: Sequence[Method], repeats: int, frames: Sequence[Frame]) -> None:
    rows = []
    for name in dict.fromkeys(frame.set_name for frame in frames):
        cases = [(frame.depth_m, frame.intrinsics) for frame in frames if frame.set_name == name]
        ms = median_ms(_quick(methods), cases, repeats)
        rows.append([name, str(len(cases)), f'{np.median(ms[0]):.1f}', f'{ms[0].max():.1f}',
                     *(f'{np.median(one):.1f}' for one in ms[1:]),
                     *(f'{np.median(one) / np.median(ms[0]):.2f}' for one in ms[1:])])
    if rows:
        first, ours, *others = _header('frames', methods)
        emit('### Time on real frames, depth of the sensor',
             table([first, 'number', f'{ours}, median', 'worst', *others], rows))


def _report_sizes(methods: Sequence[Method], repeats: int) -> None:
    rows = []
    for width, height in SIZES:
        scenes = [_sized_room(seed, width, height) for seed in range(HELD_OUT, HELD_OUT + 3)]
        ms = median_ms(_quick(methods), [(one.depth_m, one.intrinsics) for one in scenes],
                       repeats)
        per_pixel_ns = 1e6 * ms.mean(1) / (width * height)
        rows.append([f'{width} x {height}', *_cells(ms),
                     *(f'{one:.0f}' for one in per_pixel_ns)])
    header = [*_header('image', methods),
              *(f'{method.name} (ns a pixel)' for method in _quick(methods))]
    emit('### Time by resolution, clean rooms', table(header, rows))


def _header(first: str, methods: Sequence[Method]) -> list[str]:
    quick = _quick(methods)
    return [first, *(f'{method.name} (ms)' for method in quick),
            *(f'{method.name}, times ours' for method in quick[1:])]


def _cells(ms: np.ndarray) -> list[str]:
    """Return mean times over the cases, and the times of the others divided by ours."""
    mean = ms.mean(axis=1)
    return [*(f'{one:.1f}' for one in mean), *(f'{one / mean[0]:.2f}' for one in mean[1:])]


def _sized_room(seed: int, width: int, height: int) -> Scene:
    """Return a room seen by a camera of 525 px focal length at a width of 640."""
    focal_px = 525.0 * width / 640
    intrinsics = CameraIntrinsics(focal_px, focal_px, (width - 1) / 2, (height - 1) / 2, width,
                                  height)
    return random_room(np.random.default_rng(seed), intrinsics)
