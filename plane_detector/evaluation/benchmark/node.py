# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The node as a process of its own over DDS: rate, time per stage, time on the cores.

A rendered room is published at a constant rate: image, camera_info and, where the depth comes
from a topic, depth. Then the same frame is processed without DDS, and each message timed alone.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import rclpy
from rclpy.serialization import serialize_message
from std_msgs.msg import Header
from tqdm import tqdm

from plane_detector.config import Config, DepthConfig, NodeConfig
from plane_detector.depth.model_zoo import fetch
from plane_detector.evaluation.benchmark.node_load import CameraLoad, Load, input_messages
from plane_detector.evaluation.benchmark.rooms import HELD_OUT, room
from plane_detector.evaluation.benchmark.tables import emit, table
from plane_detector.pipeline import PlaneDetector
from plane_detector.ros.allocator import keep_freed_memory
from plane_detector.ros.frame_processor import FrameProcessor
from plane_detector.ros.inputs.synchronizer import Frame
from plane_detector.ros.outputs.topics import OUTPUTS
from plane_detector.tools.demo.node_process import NodeProcess, use_private_domain

SUBSCRIPTIONS = {'planes': ('planes',), 'points, planes': ('points', 'planes'),
                 'all': tuple(OUTPUTS)}
_STAGES = ('convert', 'depth', 'wait', 'directions', 'segmentation', 'scale', 'measurement',
           'shapes', 'tracking', 'messages', 'publish', 'total')
_NODE_ALONE = ('convert', 'tracking', 'messages')
_REPEATS = 50


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('--model', default='fastdepth',
                        help='network of the second source, as depth.model; none: leave it out')
    parser.add_argument('--rate', type=_rate, default=30.0, help='of the images, Hz')
    parser.add_argument('--seconds', type=_seconds, default=10.0, help='of every row')


def _rate(text: str) -> float:
    if not 0 < float(text) <= 1000:
        raise argparse.ArgumentTypeError(f'{text} must be above 0 and at most 1000')
    return float(text)


def _seconds(text: str) -> float:
    if float(text) < 2:
        raise argparse.ArgumentTypeError(f'{text} must be at least 2: the diagnostics come once '
                                         'a second')
    return float(text)


def sources(model: str) -> Iterator[tuple[str, DepthConfig]]:
    """Yield name and settings of each source of depth; says why when one is not there."""
    yield 'depth topic', DepthConfig(source='topic')
    if model != 'none':
        try:
            fetch(model)
        except FileNotFoundError as error:
            emit(f'{model}: absent, {error}')
        else:
            yield model, DepthConfig(model=model)


def report_load(found: Sequence[tuple[str, DepthConfig]], rate_hz: float,
                seconds: float) -> None:
    """Print what the running node does, by source of depth and by what is subscribed to."""
    rows = []
    for name, depth in found:
        for subscribed, outputs in tqdm(SUBSCRIPTIONS.items(), name, leave=False):
            load_before = os.getloadavg()[0]
            load = _load(depth, outputs, rate_hz, seconds)
            rows.append([name, subscribed, *_cells(load), f'{load_before:.1f}'])
    emit(f'### The node over DDS, room {HELD_OUT} at 640 x 480, images at {rate_hz:g} Hz',
         table(('depth', 'subscribed', 'rate (Hz)', *(f'{one} (ms)' for one in _STAGES),
                'messages\' share', 'core time (ms)', 'without a core (ms)', 'load before'), rows),
         'Medians of what /diagnostics says. Messages\' share: making and publishing them. Core '
         'time: of all threads, per frame; beside it how long they would have worked but other '
         'programs had the cores. Load: of the machine in the minute before.')


def _load(depth: DepthConfig, outputs: Sequence[str], rate_hz: float, seconds: float) -> Load:
    """Start a node, feed it, end it."""
    parameters = {'depth.source': depth.source, 'depth.model': depth.model}
    with (tempfile.TemporaryDirectory() as folder,
          NodeProcess(parameters, Path(folder) / 'node.log') as process):
        camera = CameraLoad(process.check_running, room(HELD_OUT), rate_hz,
                            depth.source == 'topic', outputs)
        try:
            return camera.measure(process.process_id, seconds)
        finally:
            camera.close()


def _cells(load: Load) -> list[str]:
    share = (load.stage_ms['messages'] + load.stage_ms['publish']) / load.stage_ms['total']
    return [f'{load.rate_hz:.1f}', *(f'{load.stage_ms[stage]:.1f}' for stage in _STAGES),
            f'{share:.0%}', f'{load.busy_ms:.0f}', f'{load.waiting_ms:.0f}']


def report_in_process(found: Sequence[tuple[str, DepthConfig]]) -> None:
    """Print the time of the same work without DDS, stage by stage, all messages included."""
    stages = _STAGES[:-2]
    rows = []
    for name, depth in found:
        processor = FrameProcessor(PlaneDetector(Config(depth=depth)), NodeConfig(), 'image')
        frame = _frame(depth.source == 'topic')
        processor.process(frame)
        taken = [processor.process(frame).stage_seconds for _ in range(_REPEATS)]
        ms = [1e3 * float(np.median([one[stage] for one in taken])) for stage in stages]
        around = sum(one for stage, one in zip(stages, ms, strict=True) if stage in _NODE_ALONE)
        rows.append([name, *(f'{one:.1f}' for one in (*ms, sum(ms), around))])
    emit('### The same frame without DDS, all messages made',
         table(('depth', *(f'{stage} (ms)' for stage in stages), 'total (ms)',
                'of it ' + ', '.join(_NODE_ALONE) + ' (ms)'), rows))


def report_messages() -> None:
    """Print the time and the size of each message alone."""
    processor = FrameProcessor(PlaneDetector(Config(depth=DepthConfig(source='topic'))),
                               NodeConfig(), 'image')
    result = processor.process(_frame(True)).result
    rows = []
    for name, output in OUTPUTS.items():
        msg = output.make(result)
        if msg is not None:
            # A copy has nothing at hand yet of what several messages share.
            ms = _median_ms(lambda make=output.make: make(replace(result)))
            rows.append([f'~/{name}', f'{ms:.2f}', f'{len(serialize_message(msg)) / 1e6:.3f}'])
    emit(f'### Each message alone, {len(result.detection.planes)} planes',
         table(('message', 'time to make (ms)', 'size (MB)'), rows),
         'What messages share, the label of each pixel and the points, is in each of these times '
         'but made once a frame.')


def _frame(with_depth: bool) -> Frame:
    sent = input_messages(Header(), room(HELD_OUT))
    depth = sent['depth'] if with_depth else None
    return Frame(sent['image'], sent['camera_info'], depth, gravity_camera=None, epoch=0)


def _median_ms(call: Callable[[], object]) -> float:
    taken = []
    for _ in range(_REPEATS):
        start_s = time.perf_counter()
        call()
        taken.append(time.perf_counter() - start_s)
    return 1e3 * float(np.median(taken))


def run(options: argparse.Namespace) -> None:
    """Print the tables."""
    keep_freed_memory()  # as the node does
    use_private_domain()
    found = list(sources(options.model))
    rclpy.init()
    try:
        report_load(found, options.rate, options.seconds)
    finally:
        rclpy.try_shutdown()
    report_in_process(found)
    report_messages()
