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
from plane_detector.evaluation.benchmark.report import at_least_one, emit, table
from plane_detector.evaluation.benchmark.samples import room

WARM_UP = 5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('models', nargs='+', metavar='MODEL',
                        help='name in the zoo, or path of an .onnx file')
    parser.add_argument('--provider', default='CPUExecutionProvider')
    parser.add_argument('--output', default='auto', help='of a file, as depth.output')
    parser.add_argument('--short-side', type=int, default=0, help='as depth.short_side')
    parser.add_argument('--images', type=at_least_one, default=50)


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    with one_thread():
        rows = [_row(DepthConfig(model=model, output=options.output, noise_share=0.005,
                                 short_side=options.short_side, providers=(options.provider,)),
                     options.images) for model in options.models]
    emit(f'### Networks on {options.provider}, milliseconds for an image of 640 x 480',
         table(('network', 'input', 'start (s)', 'first image of a new size', 'predict',
                'depth stage', 'detect'), rows),
         f'Medians of {options.images} images of a rendered room, wall clock, one thread. '
         '"predict" resizes the image, runs the network and resizes its output; the depth stage '
         'also averages and checks it; "detect" is all from the image to the planes.')


def _row(config: DepthConfig, images: int) -> list[str]:
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

    times_ms = [_median(call, images)
                for call in (lambda: model.predict(rgb, intrinsics), stage, detect)]
    width, height = model.input_size(intrinsics.width, intrinsics.height)
    return [model.name, f'{width} x {height}', f'{start_s:.1f}', f'{new_size_ms:.0f}',
            *(f'{time_ms:.1f}' for time_ms in times_ms)]


def _median(call: Callable[[], object], images: int) -> float:
    """Return the median time of a call in milliseconds."""
    return float(np.median([_timed(call) for _ in range(WARM_UP + images)][WARM_UP:]))


def _timed(call: Callable[[], object]) -> float:
    start_s = time.perf_counter()
    call()
    return 1e3 * (time.perf_counter() - start_s)
