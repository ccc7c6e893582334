# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Time of depth networks on an execution provider, alone and in the pipeline."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from plane_detector import Config, PlaneDetector
from plane_detector._runtime.process import one_thread
from plane_detector.config import DepthConfig
from plane_detector.depth.networks import NETWORKS
from plane_detector.evaluation.benchmark.report import at_least_one, emit, table
from plane_detector.evaluation.benchmark.samples import room

WARM_UP = 5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('models', nargs='+', metavar='MODEL',
                        help='name in the zoo, or path of an .onnx file')
    parser.add_argument('--provider', default='CPUExecutionProvider')
    parser.add_argument('--output', default='auto', help='of files, as depth.output')
    parser.add_argument('--short-side', type=int, nargs='+', default=[0],
                        help='as depth.short_side; a row for each, if the input has any size')
    parser.add_argument('--images', type=at_least_one, default=50)


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    with one_thread():
        rows = [_row(DepthConfig(
            model=model, output='auto' if model in NETWORKS else options.output, short_side=side,
            noise_share=0.005, providers=(options.provider,)), options.images)
            for model in options.models for side in options.short_side]
        rows = {(network, size): (network, size, *times) for network, size, *times in rows}
    emit(f'### Networks on {options.provider}, milliseconds for an image of 640 x 480',
         table(('network', 'input', 'start (s)', 'first image of a new size', 'predict',
                '... core time', 'depth stage', 'detect'), rows.values()),
         f'Medians of {options.images} images of a rendered room, wall clock; one thread, except '
         'for the network. "predict" resizes the image, runs the network and resizes its output; '
         'its core time is that of all threads; the depth stage also averages and checks the '
         'output; "detect" is all from the image to the planes.')


def _row(config: DepthConfig, images: int) -> list[str]:
    """Return the row of a network with one input size."""
    rgb, intrinsics = room(9000).rgb, room(9000).intrinsics
    start_s = time.perf_counter()
    detector = PlaneDetector(Config(depth=config))
    start_s = time.perf_counter() - start_s
    model, stamps_s = detector.source.model, iter(np.arange(1, 1e6) / 30)
    # An image of another shape, for which no input size has been prepared.
    wide = np.ascontiguousarray(rgb[60:420])
    lens = replace(intrinsics, height=wide.shape[0], cy=intrinsics.cy - 60)
    new_size_ms = _timed(lambda: model.predict(wide, lens))

    def stage() -> None:
        detector.estimate_depth(rgb, intrinsics, stamp_s=next(stamps_s))

    def detect() -> None:
        detector.detect(rgb, intrinsics, stamp_s=next(stamps_s))

    def predict() -> None:
        model.predict(rgb, intrinsics)

    times_ms = [_median(predict, images), _median(predict, images, time.process_time),
                _median(stage, images), _median(detect, images)]
    width, height = model.input_size(intrinsics.width, intrinsics.height)
    return [model.name, f'{width} x {height}', f'{start_s:.1f}', f'{new_size_ms:.0f}',
            *(f'{time_ms:.1f}' for time_ms in times_ms)]


def _median(call: Callable[[], object], images: int,
            clock: Callable[[], float] = time.perf_counter) -> float:
    """Return the median time of a call in milliseconds."""
    return float(np.median([_timed(call, clock) for _ in range(WARM_UP + images)][WARM_UP:]))


def _timed(call: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> float:
    start_s = clock()
    call()
    return 1e3 * (clock() - start_s)
