# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Print how long the depth stage takes, by input size and execution provider, as Markdown.

    python3 -m plane_detector.evaluation.benchmark.depth_network fastdepth
    python3 -m plane_detector.evaluation.benchmark.depth_network F.onnx --output relative_disparity
"""

from __future__ import annotations

import argparse
import os
import platform
import shlex
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from plane_detector.config import DepthConfig
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.depth.onnx_session import RUNTIME, available_providers
from plane_detector.depth.preprocessing import InputRecipe, finish_output, prepare_input

_HEADER = ('| provider | input | depth stage, median (ms) | fastest (ms) '
           '| of it resampling (ms) | pictures per second |\n|---|---|---|---|---|---|')


def machine() -> str:
    """Return processor, cores and versions in a line."""
    processor = platform.processor() or platform.machine()
    info = Path('/proc/cpuinfo')
    if info.is_file():
        names = [line.split(':', 1)[1] for line in info.read_text().splitlines()
                 if line.startswith('model name')]
        processor = names[0].strip() if names else processor
    return (f'{processor}, {os.cpu_count()} cores, Python {platform.python_version()}, '
            f'{RUNTIME}')


def seconds(call: Callable[[], object], at_least_s: float) -> np.ndarray:
    """Return the time of each of five calls or more, for as long as ``at_least_s``."""
    taken: list[float] = []
    while len(taken) < 5 or sum(taken) < at_least_s:
        start = time.perf_counter()
        call()
        taken.append(time.perf_counter() - start)
    return np.array(taken)


def row(config: DepthConfig, rgb: np.ndarray, at_least_s: float) -> str:
    """Return the table's row of one provider and input size."""
    estimate = DepthEstimator(config)
    height, width = rgb.shape[:2]
    size = estimate.input_size(width, height)
    estimate(rgb)
    stage_ms = 1e3 * seconds(lambda: estimate(rgb), at_least_s)
    recipe = InputRecipe(config.input_scale, config.mean, config.std)
    raw = np.ones(size[::-1], np.float32)
    resampling_ms = 1e3 * np.median(seconds(lambda: (
        prepare_input(rgb, size, recipe),
        finish_output(raw, (width, height), estimate.output, config.max_depth)), 0.2))
    median_ms = np.median(stage_ms)
    return (f'| {estimate.provider} | {size[0]} x {size[1]} | {median_ms:.1f} '
            f'| {stage_ms.min():.1f} | {resampling_ms:.1f} | {1e3 / median_ms:.1f} |')


def parsed() -> argparse.Namespace:
    """Return the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('model', help='as depth.model: a name of the zoo, a path, or auto')
    parser.add_argument('--output', default='auto', help='as depth.output, needed for a path')
    parser.add_argument('--short-side', type=int, nargs='+', default=[252, 392, 518],
                        help='of the input, for networks of free size')
    parser.add_argument('--size', type=int, nargs=2, default=[640, 480],
                        metavar=('WIDTH', 'HEIGHT'), help='of the picture')
    parser.add_argument('--threads', type=int, default=0, help='as depth.threads')
    parser.add_argument('--seconds', type=float, default=3.0, help='per row, at least')
    return parser.parse_args()


def main() -> None:
    """Print the command, the machine and the table, a row as soon as it is measured."""
    arguments = parsed()
    width, height = arguments.size
    rgb = np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)
    command = ['python3', '-m', 'plane_detector.evaluation.benchmark.depth_network', *sys.argv[1:]]
    print(f'`{shlex.join(command)}`\n\n{machine()}; picture {width} x {height}; threads '
          f'{arguments.threads or "by ONNX Runtime"}\n\n{_HEADER}', flush=True)
    for provider in available_providers():
        for short_side in arguments.short_side:
            config = DepthConfig(model=arguments.model, output=arguments.output,
                                 short_side=short_side, providers=(provider,),
                                 threads=arguments.threads)
            try:
                line = row(config, rgb, arguments.seconds)
            except (ValueError, FileNotFoundError) as error:
                sys.exit(f'{error}')
            print(line, flush=True)


if __name__ == '__main__':
    main()
