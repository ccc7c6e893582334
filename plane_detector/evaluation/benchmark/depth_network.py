# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Time of the depth stage, by input size and execution provider."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

from plane_detector.config import DepthConfig
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.depth.onnx_session import RUNTIME, available_providers
from plane_detector.depth.preprocessing import InputRecipe, finish_output, prepare_input
from plane_detector.evaluation.benchmark.report import emit, table


def seconds(call: Callable[[], object], at_least_s: float) -> np.ndarray:
    """Return the times of at least five calls, taking at least ``at_least_s`` in total."""
    taken: list[float] = []
    while len(taken) < 5 or sum(taken) < at_least_s:
        start = time.perf_counter()
        call()
        taken.append(time.perf_counter() - start)
    return np.array(taken)


def row(config: DepthConfig, rgb: np.ndarray) -> list[str]:
    """Return the cells for one provider and input size."""
    estimate = DepthEstimator(config)
    height, width = rgb.shape[:2]
    size = estimate.input_size(width, height)
    estimate(rgb)
    stage_ms = 1e3 * seconds(lambda: estimate(rgb), 3.0)
    recipe = InputRecipe(config.input_scale, config.mean, config.std)
    raw = np.ones(size[::-1], np.float32)
    resampling_ms = 1e3 * np.median(seconds(lambda: (
        prepare_input(rgb, size, recipe),
        finish_output(raw, (width, height), estimate.output)), 0.2))
    median_ms = np.median(stage_ms)
    return [estimate.provider, f'{size[0]} x {size[1]}', f'{median_ms:.1f}',
            f'{stage_ms.min():.1f}', f'{resampling_ms:.1f}', f'{1e3 / median_ms:.1f}']


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('model', help='as depth.model: a name of the zoo, a path, or auto')
    parser.add_argument('--output', default='auto', help='as depth.output, needed for a path')
    parser.add_argument('--short-side', type=int, nargs='+', default=[252, 392, 518],
                        help='of the input, for networks of free size')


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    rgb = np.random.default_rng(0).integers(0, 256, (480, 640, 3), dtype=np.uint8)
    rows = [row(DepthConfig(model=options.model, output=options.output, short_side=short_side,
                            providers=(provider,)), rgb)
            for provider in available_providers() for short_side in options.short_side]
    emit(f'{RUNTIME}; image 640 x 480; threads by ONNX Runtime',
         table(('provider', 'input', 'depth stage, median (ms)', 'fastest (ms)',
                'of it resampling (ms)', 'images per second'), rows))
