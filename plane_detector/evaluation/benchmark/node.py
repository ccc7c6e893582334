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
import multiprocessing
import os
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header
from tqdm import tqdm

from plane_detector._runtime.process import retain_freed_memory
from plane_detector.config import DepthConfig
from plane_detector.depth.networks import resolve
from plane_detector.evaluation.benchmark.report import HELD_OUT, add_shared, emit, table
from plane_detector.evaluation.benchmark.samples import room
from plane_detector.evaluation.datasets import Frame, frames
from plane_detector.ros.calibration import camera_info_to_msg
from plane_detector.ros.outputs import messages
from plane_detector.ros.outputs.topics import OUTPUTS
from plane_detector.tools.private_domain import private_domain

NODE = 'plane_detector'
_PROFILE = Path(__file__).resolve().parents[3] / 'config' / 'fastdds_large_messages.xml'
SUBSCRIPTIONS = {'nothing': (), 'planes': ('planes',), 'points, planes': ('points', 'planes'),
                 'all': tuple(OUTPUTS)}
HELD_S = 0.5
"""Each view is shown for this long, as with a slowly moving camera, so that labels are tracked."""
_STAGES = ('convert', 'depth', 'directions', 'segmentation', 'measurement', 'ground', 'tracking',
           'patches', 'messages', 'publish', 'total')
_ROOM = 'room'
_RELIABLE = QoSProfile(depth=2, reliability=ReliabilityPolicy.RELIABLE)
_INPUTS = {'camera_info': CameraInfo, 'depth': Image, 'image': Image}
_SPIN_S, _SETTLING_S, _START_TIMEOUT_S, _STOP_TIMEOUT_S = 0.05, 3.0, 120.0, 10.0
_TICK_S = 1 / os.sysconf('SC_CLK_TCK')
_STAMP_AT = 4  # derived: after the header of CDR, the stamp is the first field


@dataclass(frozen=True)
class Show:
    """What the camera shows."""

    title: str
    views: Sequence[Frame]  # shown in turn, each for HELD_S
    rate_hz: float  # of the images


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_shared(parser, '--data')
    parser.add_argument('--views', default='kinect',
                        help=f'set of the data folder that the camera shows, or {_ROOM} for a '
                             'rendered one (default: %(default)s)')
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


def run(options: argparse.Namespace) -> None:
    """Print the tables."""
    retain_freed_memory(one_heap=True)  # as the node does
    use_private_domain()
    if options.views == _ROOM:
        scene, title = room(HELD_OUT), f'room {HELD_OUT}'
        views = [Frame(_ROOM, title, scene.rgb, scene.depth_m, scene.intrinsics)]
    else:
        views = list(frames(options.data, (options.views,)))
        title = f'{len(views)} frames of {options.views}, each for {HELD_S:g} s'
    found = list(sources(options.model))
    rclpy.init()
    try:
        report_load(found, Show(title, views, options.rate), options.seconds)
    finally:
        rclpy.try_shutdown()


def use_private_domain() -> None:
    """
    Set the environment of this process and its children for large messages on this machine.

    Must be called before rclpy.init(). Other ROS nodes, on this machine or in the network, are not
    affected and do not interfere. Fast DDS settings of the user are kept.
    """
    os.environ['ROS_DOMAIN_ID'] = str(private_domain())
    os.environ.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', str(_PROFILE))


def sources(model: str) -> Iterator[tuple[str, DepthConfig]]:
    """Yield name and settings of each source of depth; prints why one is not available."""
    yield 'depth topic', DepthConfig(source='topic')
    if model != 'none':
        try:
            resolve(DepthConfig(model=model))
        except FileNotFoundError as error:
            emit(f'{model}: absent, {error}')
        else:
            yield model, DepthConfig(model=model)


def report_load(found: Sequence[tuple[str, DepthConfig]], show: Show, seconds: float) -> None:
    """Print measurements of the running node, by source of depth and by subscribed outputs."""
    rows, lens = [], show.views[0].intrinsics
    for name, depth in found:
        for subscribed, outputs in tqdm(SUBSCRIPTIONS.items(), name, leave=False):
            load_before = os.getloadavg()[0]
            cells = _measured(depth, outputs, show, seconds)
            rows.append([name, subscribed, *cells.values(), f'{load_before:.1f}'])
    emit(f'### The node over DDS: {show.title}, {lens.width} x {lens.height}, '
         f'images at {show.rate_hz:g} Hz',
         table(('depth', 'subscribed', *cells, 'load before'), rows),
         'Rate: of ~/planes as received. Core time: of all threads of the node, per frame '
         'published, without subscribers per image sent. Without a core: how long it would have '
         'worked but other programs had the cores. Latency: from the stamp of an image, just '
         'before it is sent, to its planes in another process. Stages: medians of what '
         '/diagnostics says. Load: of the machine in the minute before.')


def _measured(depth: DepthConfig, outputs: Sequence[str], show: Show,
              seconds: float) -> dict[str, str]:
    """Start a node and a receiver, feed them, and end them."""
    with (tempfile.TemporaryDirectory() as folder, Receiver(outputs) as receiver,
          node_process(depth, Path(folder, 'node.log')) as process):
        camera = Camera(process, show, depth.source == 'topic', receiver)
        try:
            return camera.measure(seconds)
        except RuntimeError as error:
            end = Path(folder, 'node.log').read_text(errors='replace')[-1500:]
            raise RuntimeError(f'{error}\nThe end of its log:\n{end}') from error
        finally:
            camera.close()


@contextmanager
def node_process(depth: DepthConfig, log_path: Path) -> Iterator[subprocess.Popen]:
    """Run the node with a source of depth; it is ended with SIGINT, by force if necessary."""
    with open(log_path, 'wb') as log:
        process = subprocess.Popen(
            [sys.executable, '-m', 'plane_detector.ros.node', '--ros-args', '-p',
             f'depth.source:={depth.source}', '-p', f'depth.model:={depth.model}'],
            stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT,
            start_new_session=True)  # Ctrl-C reaches only this program, which ends the node
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(_STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


class Receiver:
    """
    Receives outputs as bytes in another process; a context manager.

    Bytes show the limit of the node itself: converting them to messages in Python would use the
    node's cores.
    """

    def __init__(self, outputs: Sequence[str]) -> None:
        self.outputs = tuple(outputs)
        self._pipe, other = multiprocessing.Pipe()
        # A fork would share the threads and sockets of this process's middleware.
        self._process = multiprocessing.get_context('spawn').Process(
            target=_receive, args=(self.outputs, other), daemon=True)
        self._process.start()

    def __enter__(self) -> Receiver:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.join(_STOP_TIMEOUT_S)

    def taken(self) -> list[float]:
        """Return the time in ms from stamp to receipt of all ``~/planes`` since the last call."""
        self._pipe.send('taken')
        return self._pipe.recv()


def _receive(outputs: tuple[str, ...], pipe: Connection) -> None:
    """Receive until the process is ended."""
    retain_freed_memory(one_heap=True)  # as the node; otherwise most of its time is page faults
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # SIGTERM ends it
    node, executor = rclpy.create_node('plane_detector_receiver'), SingleThreadedExecutor()
    executor.add_node(node)
    latencies_ms: list[float] = []

    def receive_planes(data: bytes) -> None:
        seconds, nanoseconds = struct.unpack_from('<iI', data, _STAMP_AT)
        latencies_ms.append((time.time_ns() - nanoseconds) / 1e6 - 1e3 * seconds)
    for name in outputs:
        callback = receive_planes if name == 'planes' else lambda _: None
        node.create_subscription(OUTPUTS[name].msg_type, f'{NODE}/{name}', callback, _RELIABLE,
                                 raw=True)
    while True:
        executor.spin_once(timeout_sec=_SPIN_S)
        if pipe.poll():
            pipe.recv()
            pipe.send(latencies_ms.copy())
            latencies_ms.clear()


class Camera:
    """Feeds the node with views at a constant rate, and receives its diagnostics."""

    def __init__(self, process: subprocess.Popen, show: Show, with_depth: bool,
                 receiver: Receiver) -> None:
        self._process, self._receiver = process, receiver
        self._views = [input_messages(view) for view in show.views]
        self._node = rclpy.create_node('plane_detector_load')
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._publishers = {
            name: self._node.create_publisher(msg_type, name, _RELIABLE)
            for name, msg_type in _INPUTS.items() if with_depth or name != 'depth'}
        self._statuses: list[dict[str, str]] = []
        self._node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)
        self._rate_hz, self._sent = show.rate_hz, 0

    def close(self) -> None:
        """Destroy the ROS node."""
        self._executor.shutdown()
        self._node.destroy_node()

    def measure(self, seconds: float) -> dict[str, str]:
        """
        Wait for the node, feed it until its rate is steady, then measure; return cells by column.

        Raises RuntimeError if the node has ended or publishes nothing.
        """
        process_id = self._process.pid
        self._spin_until(lambda: all(one.get_subscription_count()
                                     for one in self._publishers.values()))
        start_s = time.clock_gettime(time.CLOCK_BOOTTIME) - _ticks(process_id)[19] * _TICK_S
        self._spin_until(lambda: not self._receiver.outputs
                         or self._node.count_subscribers(f'{NODE}/planes'))
        self._node.create_timer(1 / self._rate_hz, self._publish)
        # The first start compiles some kernels after the node is active.
        self._spin_until(lambda: not self._receiver.outputs or self._receiver.taken()
                         or self._statuses and self._statuses[-1].get('last_error'))
        self._spin(_SETTLING_S)
        self._receiver.taken()
        self._statuses.clear()
        sent = self._sent
        core_s, waited_s = core_seconds(process_id), waiting_seconds(process_id)
        elapsed_s = self._spin(seconds)
        core_s = core_seconds(process_id) - core_s
        waited_s = waiting_seconds(process_id) - waited_s
        latency_ms, stage_ms = self._receiver.taken(), median_stages(self._statuses)
        if self._receiver.outputs and not (latency_ms and stage_ms):
            last = self._statuses[-1:] or [{}]
            raise RuntimeError(f'the node gave no planes: {last[0].get("last_error", "")}')
        images = len(latency_ms) or self._sent - sent
        median_ms, most_ms, worst_ms = np.quantile(latency_ms or [np.nan], (0.5, 0.95, 1.0))
        return {'rate (Hz)': f'{len(latency_ms) / elapsed_s:.1f}',
                'of a core': f'{core_s / elapsed_s:.0%}',
                'core time (ms)': f'{1e3 * core_s / images:.1f}',
                'without a core (ms)': f'{1e3 * waited_s / images:.1f}',
                'latency: median (ms)': f'{median_ms:.1f}', '95 % (ms)': f'{most_ms:.1f}',
                'worst (ms)': f'{worst_ms:.1f}', 'resident (MB)': f'{resident_mb(process_id):.0f}',
                'ready after (s)': f'{start_s:.1f}',
                **{f'{stage} (ms)': f'{stage_ms.get(stage, 0.0):.1f}' for stage in _STAGES}}

    def _spin_until(self, condition: Callable[[], object]) -> None:
        deadline_s = time.monotonic() + _START_TIMEOUT_S
        while not condition():
            if time.monotonic() > deadline_s:
                raise RuntimeError(f'the node gave nothing within {_START_TIMEOUT_S:g} s')
            self._spin(_SPIN_S)

    def _spin(self, seconds: float) -> float:
        """Spin for some time; return the actual duration in seconds."""
        start_s = time.monotonic()
        while (elapsed_s := time.monotonic() - start_s) < seconds:
            if self._process.poll() is not None:
                raise RuntimeError(f'the node ended with exit code {self._process.returncode}')
            self._executor.spin_once(timeout_sec=_SPIN_S)
        return elapsed_s

    def _publish(self) -> None:
        stamp = self._node.get_clock().now().to_msg()
        shown = int(self._sent / self._rate_hz / HELD_S)
        image = self._views[shown % len(self._views)]
        self._sent += 1
        for name, publisher in self._publishers.items():
            image[name].header.stamp = stamp
            publisher.publish(image[name])

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        self._statuses += [{pair.key: pair.value for pair in status.values}
                           for status in msg.status if status.name == NODE]


def input_messages(view: Frame) -> dict[str, Any]:
    """Return the messages that a camera publishes for a view, by topic."""
    header = Header(frame_id='camera_optical_frame')
    return {'camera_info': camera_info_to_msg(header, view.intrinsics),
            'depth': messages.depth_to_msg(header, view.depth_m),
            'image': messages.rgb_to_msg(header, view.rgb)}


def median_stages(statuses: Sequence[dict[str, str]]) -> dict[str, float]:
    """Return the median of each stage's time in milliseconds over the seconds with frames."""
    times = [{key.removeprefix('latency.').removesuffix('_ms'): float(value)
              for key, value in status.items() if key.startswith('latency.')}
             for status in statuses]
    times = [stages for stages in times if len(stages) > 1]  # without frames only a total
    return {stage: float(np.median([stages[stage] for stages in times]))
            for stage in (times[-1] if times else {})}


def core_seconds(process_id: int) -> float:
    """Return the time that all threads of a process, also ended ones, ran; Linux only."""
    return sum(_ticks(process_id)[11:13]) * _TICK_S


def _ticks(process_id: int) -> list[int]:
    """Return the fields of /proc/PID/stat from the third on, the state as 0; see proc(5)."""
    fields = Path(f'/proc/{process_id}/stat').read_text().rpartition(')')[2].split()
    return [0, *map(int, fields[1:])]


def waiting_seconds(process_id: int) -> float:
    """Return how long the threads of a process have waited for a core; Linux only."""
    waited_ns = 0
    for file in Path(f'/proc/{process_id}/task').glob('*/schedstat'):
        with suppress(OSError):  # a thread that has ended in the meantime
            waited_ns += int(file.read_text().split()[1])
    return 1e-9 * waited_ns


def resident_mb(process_id: int) -> float:
    """Return VmRSS of a process in MB; Linux only."""
    rows = Path(f'/proc/{process_id}/status').read_text().splitlines()
    return next(int(row.split()[1]) * 1024 / 1e6 for row in rows if row.startswith('VmRSS:'))
