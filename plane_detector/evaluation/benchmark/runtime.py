# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Run time on one thread, of our method and the others side by side.

The methods take turns, so that other load on the machine affects all of them equally. Points and
calibration are prepared for the other methods before the clock starts; ours is timed from the
depth image to the labels of all pixels and the measured planes.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from tqdm import tqdm

from plane_detector.evaluation.benchmark.rooms import HELD_OUT, noisy_depth, room
from plane_detector.evaluation.benchmark.tables import emit, table
from plane_detector.evaluation.datasets import Frame
from plane_detector.evaluation.peers import Method, OpenCv, Ours
from plane_detector.evaluation.scenes.rooms import (
    VGA,
    Rectangle,
    Scene,
    camera_rotation,
    random_room,
    render,
)
from plane_detector.process import one_thread
from plane_detector.types import CameraIntrinsics

SIZES = ((320, 240), (640, 480), (1280, 720))
PLANES_A_SIDE = (1, 2, 3, 4, 5)
SLOW_REPEATS = 3
_MOSAIC_DISTANCE_M = 3.0

Case = tuple[np.ndarray, CameraIntrinsics]


def report_times(methods: Sequence[Method], repeats: int, frames: Sequence[Frame]) -> None:
    """Print the tables of times; with real frames one more."""
    present = [method for method in methods if not method.absent]
    with one_thread():
        _report_peers(present, repeats)
        _report_noise(present, repeats)
        _report_real(present, repeats, frames)
        _report_sizes(present, repeats)
        _report_plane_counts(present, repeats)


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


def _report_noise(methods: Sequence[Method], repeats: int) -> None:
    seeds = range(HELD_OUT, HELD_OUT + 5)
    rows = []
    for sigma in (0.0, 0.0001, 0.0003, 0.001, 0.004, 0.01):
        cases = [(noisy_depth(room(seed), sigma, seed), VGA) for seed in seeds]
        rows.append([f'{sigma:g}', *_cells(median_ms(_quick(methods), cases, repeats))])
    emit(f'### Time by noise, 640 x 480, rooms {seeds[0]} to {seeds[-1]}',
         table(_header('noise (1/m)', methods), rows))


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


def _report_plane_counts(methods: Sequence[Method], repeats: int) -> None:
    rows = []
    for side in PLANES_A_SIDE:
        scene = mosaic(side)
        case = (scene.depth_m, scene.intrinsics)
        found = len(Ours()(*case)[1])
        rows.append([str(side**2), str(found),
                     *_cells(median_ms(_quick(methods), [case], repeats))])
    emit('### Time by number of planes, 640 x 480, a mosaic of tilted tiles',
         table(['planes', 'found by ours', *_header('', methods)[1:]], rows))


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


def mosaic(side: int, intrinsics: CameraIntrinsics = VGA) -> Scene:
    """Return side x side tiles in front of the camera, each with its own tilt."""
    rng = np.random.default_rng(side)
    extent_m = _MOSAIC_DISTANCE_M * np.array([intrinsics.width / intrinsics.fx,
                                              intrinsics.height / intrinsics.fy]) / side
    tiles = []
    for i, j in np.ndindex(side, side):
        across, up = (camera_rotation(*rng.uniform(-20, 20, 3)) @ axis * 1.1 * length
                      for axis, length in zip(np.eye(3)[:2], extent_m, strict=True))
        centre = np.array([(i + 0.5 - side / 2) * extent_m[0], _MOSAIC_DISTANCE_M,
                           (j + 0.5 - side / 2) * extent_m[1]])
        tiles.append(Rectangle(centre - (across + up) / 2, across, up))
    return render(tiles, camera_rotation(0, 0, 0), np.zeros(3), intrinsics, rng)
