# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The node as a separate process over DDS: rate, latency, time on the cores, memory, start.

Views are published at a constant rate: image, camera_info and, for depth from a topic, depth. They
are real images with sensor depth, or a rendered room. Three processes share the cores: the camera
(this program), the node, and a receiver that takes the outputs as bytes.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import rclpy
from tqdm import tqdm

from plane_detector.config import DepthConfig
from plane_detector.depth.model_zoo import fetch
from plane_detector.evaluation.benchmark.node_load import HELD_S, CameraLoad, Load, Show
from plane_detector.evaluation.benchmark.node_process import NodeProcess, use_private_domain
from plane_detector.evaluation.benchmark.node_receiver import Receiver
from plane_detector.evaluation.benchmark.node_transport import report_transport
from plane_detector.evaluation.benchmark.options import add_data
from plane_detector.evaluation.benchmark.rooms import HELD_OUT, room
from plane_detector.evaluation.benchmark.tables import emit, table
from plane_detector.evaluation.datasets import Frame, frames
from plane_detector.process import retain_freed_memory
from plane_detector.ros.outputs.topics import OUTPUTS

SUBSCRIPTIONS = {'nothing': (), 'planes': ('planes',), 'points, planes': ('points', 'planes'),
                 'all': tuple(OUTPUTS)}
_STAGES = ('convert', 'depth', 'directions', 'segmentation', 'measurement', 'ground', 'tracking',
           'messages', 'publish', 'total')
_ROOM = 'room'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_data(parser)
    parser.add_argument('--views', default='kinect',
                        help=f'set of the data folder that the camera shows, or {_ROOM} for a '
                             'rendered one (default: %(default)s)')
    parser.add_argument('--model', default='fastdepth',
                        help='network of the second source, as depth.model; none: leave it out')
    parser.add_argument('--rate', type=_rate, default=30.0, help='of the images, Hz')
    parser.add_argument('--motion', type=int, default=0, metavar='PIXELS',
                        help='by which each image is moved sideways against the one before; 0: a '
                             'still camera, with which the node has less work')
    parser.add_argument('--seconds', type=_seconds, default=10.0, help='of every row')
    parser.add_argument('--transport', action='store_true',
                        help='without the node: how many images of which size arrive in another '
                             'process, by QoS and Fast DDS profile')


def _rate(text: str) -> float:
    if not 0 < float(text) <= 1000:
        raise argparse.ArgumentTypeError(f'{text} must be above 0 and at most 1000')
    return float(text)


def _seconds(text: str) -> float:
    if float(text) < 2:
        raise argparse.ArgumentTypeError(f'{text} must be at least 2: the diagnostics come once '
                                         'a second')
    return float(text)


def views_of(data: Path, name: str) -> tuple[str, list[Frame]]:
    """
    Return a description of the views, and the views.

    Raises
    ------
    FileNotFoundError
        The set does not exist.

    """
    if name == _ROOM:
        scene = room(HELD_OUT)
        return f'room {HELD_OUT}', [Frame(_ROOM, str(HELD_OUT), scene.rgb, scene.depth_m,
                                          scene.intrinsics)]
    found = list(frames(data, (name,)))
    return f'{len(found)} frames of {name}, each for {HELD_S:g} s', found


def sources(model: str, rate_hz: float) -> Iterator[tuple[str, DepthConfig]]:
    """
    Yield name and settings of each source of depth; prints why one is not available.

    A network is run at best quality, the default, and told to keep the rate.
    """
    yield 'depth topic', DepthConfig(source='topic')
    if model != 'none':
        try:
            fetch(model)
        except FileNotFoundError as error:
            emit(f'{model}: absent, {error}')
        else:
            yield model, DepthConfig(model=model)
            yield (f'{model}, depth.target_rate {rate_hz:g}',
                   DepthConfig(model=model, target_rate=rate_hz))


def report_load(found: Sequence[tuple[str, DepthConfig]], show: Show, seconds: float) -> None:
    """Print measurements of the running node, by source of depth and by subscribed outputs."""
    rows, lens = [], show.views[0].intrinsics
    for name, depth in found:
        for subscribed, outputs in tqdm(SUBSCRIPTIONS.items(), name, leave=False):
            load_before = os.getloadavg()[0]
            load = _load(depth, outputs, show, seconds)
            rows.append([name, subscribed, *_cells(load), f'{load_before:.1f}'])
    camera = f'moved by {show.motion_px} px from image to image' if show.motion_px else 'still'
    emit(f'### The node over DDS: {show.title}, {lens.width} x {lens.height}, '
         f'images at {show.rate_hz:g} Hz, {camera}',
         table(('depth', 'subscribed', 'rate (Hz)', 'of a core', 'core time (ms)',
                'without a core (ms)', 'latency: median (ms)', '95 % (ms)', 'worst (ms)',
                'resident (MB)', 'proportional (MB)', 'ready after (s)', 'with core time (s)',
                *(f'{one} (ms)' for one in _STAGES), 'load before'), rows),
         'Rate: of ~/planes as received. Core time: of all threads of the node, per frame '
         'published, without subscribers per image sent. Without a core: how long it would have '
         'worked but other programs had the cores. Latency: from the stamp of an image, just '
         'before it is sent, to its planes in another process. Memory: VmRSS and Pss. Stages: '
         'medians of what /diagnostics says. The camera, the node and the receiver, which takes '
         'bytes, are three processes on the same cores. Load: of the machine in the minute '
         'before.')


def _load(depth: DepthConfig, outputs: Sequence[str], show: Show, seconds: float) -> Load:
    """Start a node and a receiver, feed them, and end them."""
    parameters = {'depth.source': depth.source, 'depth.model': depth.model,
                  'depth.target_rate': depth.target_rate}
    with (tempfile.TemporaryDirectory() as folder, Receiver(outputs) as receiver,
          NodeProcess(parameters, Path(folder) / 'node.log') as process):
        camera = CameraLoad(process.check_running, show, depth.source == 'topic', receiver)
        try:
            return camera.measure(process.process_id, seconds)
        finally:
            camera.close()


def _cells(load: Load) -> list[str]:
    return [f'{load.rate_hz:.1f}', f'{load.core_share:.0%}', f'{load.busy_ms:.1f}',
            f'{load.waiting_ms:.1f}', *(f'{one:.1f}' for one in load.latency_ms),
            f'{load.resident_mb:.0f}', f'{load.proportional_mb:.0f}', f'{load.start_s:.1f}',
            f'{load.start_core_s:.1f}',
            *(f'{load.stage_ms.get(stage, 0.0):.1f}' for stage in _STAGES)]


def run(options: argparse.Namespace) -> None:
    """Print the tables."""
    if options.transport:
        report_transport(options.rate, options.seconds)
        return
    retain_freed_memory(one_heap=True)  # as the node does
    use_private_domain()
    title, views = views_of(options.data, options.views)
    found = list(sources(options.model, options.rate))
    rclpy.init()
    try:
        report_load(found, Show(title, views, options.rate, options.motion), options.seconds)
    finally:
        rclpy.try_shutdown()
