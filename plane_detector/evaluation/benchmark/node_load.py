# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A camera with a constant rate, and measurements of the node that receives its images."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from plane_detector.evaluation.benchmark.node_process import FRAME_ID, NODE
from plane_detector.evaluation.benchmark.node_receiver import RELIABLE, Receiver
from plane_detector.evaluation.datasets import Frame
from plane_detector.ros.calibration import camera_info_to_msg
from plane_detector.ros.outputs import messages

HELD_S = 0.5
"""Each view is shown for this long, as by a slowly moving camera, so that labels are tracked."""
_SHIFTS = 0, 1, 2, 1
"""Sideways positions of consecutive images of a view, in units of the motion."""
_INPUTS = {'camera_info': CameraInfo, 'depth': Image, 'image': Image}
_SETTLING_S = 3.0
_START_TIMEOUT_S = 120.0
_SPIN_S = 0.05
_TICK_S = 1 / os.sysconf('SC_CLK_TCK')


@dataclass(frozen=True)
class Show:
    """What the camera shows."""

    title: str
    views: Sequence[Frame]  # shown in turn, each for HELD_S
    rate_hz: float  # of the images
    motion_px: int = 0  # each image is moved sideways against the one before; 0: a still camera


@dataclass(frozen=True)
class Load:
    """Measurements of a node under load."""

    rate_hz: float  # of ~/planes, as received
    latency_ms: np.ndarray  # from stamp to receipt of ~/planes: median, 95 %, worst; NaN: none
    stage_ms: dict[str, float]  # median over the seconds of its mean, from the diagnostics
    core_share: float  # time of all threads on a core, as a share of the time that passed
    busy_ms: float  # on a core per frame, all threads
    waiting_ms: float  # per frame, for a core that other programs were using
    resident_mb: float
    proportional_mb: float  # with a share of pages that processes have in common
    start_s: float  # from the start of the process until it has subscribed
    start_core_s: float  # on a core in that time


class CameraLoad:
    """
    Feeds the node with views at a constant rate, and receives its diagnostics.

    Parameters
    ----------
    check_running : callable
        Raises if the node has ended; called while waiting.
    show : Show
    with_depth : bool
        Whether to publish depth too.
    receiver : Receiver
        Of the outputs, including ``planes``.

    """

    def __init__(self, check_running: Callable[[], None], show: Show, with_depth: bool,
                 receiver: Receiver) -> None:
        self._check_running, self._receiver = check_running, receiver
        self._views = [[input_messages(Header(frame_id=FRAME_ID),
                                       _moved(view, shift * show.motion_px))
                        for shift in _SHIFTS] for view in show.views]
        self._node = rclpy.create_node('plane_detector_load')
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._publishers = {
            name: self._node.create_publisher(msg_type, name, RELIABLE)
            for name, msg_type in _INPUTS.items() if with_depth or name != 'depth'}
        self._statuses: list[dict[str, str]] = []
        self._node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)
        self._rate_hz, self._sent = show.rate_hz, 0

    def close(self) -> None:
        """Destroy the ROS node."""
        self._executor.shutdown()
        self._node.destroy_node()

    def measure(self, process_id: int, seconds: float) -> Load:
        """
        Wait for the node, feed it until its rate is steady, then measure.

        Raises
        ------
        RuntimeError
            The node has ended, or published nothing.

        """
        start_s, start_core_s = self._wait_for_node(process_id)
        self._node.create_timer(1 / self._rate_hz, self._publish)
        self._spin(_SETTLING_S)
        self._receiver.taken()
        self._statuses.clear()
        sent = self._sent
        core_s, waited_s = core_seconds(process_id), waiting_seconds(process_id)
        elapsed_s = self._spin(seconds)
        core_s = core_seconds(process_id) - core_s
        waited_s = waiting_seconds(process_id) - waited_s
        latency_ms = self._receiver.taken()
        stage_ms = median_stages(self._statuses)
        if self._receiver.outputs and not (len(latency_ms) and stage_ms):
            last = self._statuses[-1:] or [{}]
            raise RuntimeError(f'the node gave no planes: {last[0].get("last_error", "")}')
        frames = len(latency_ms) or self._sent - sent
        return Load(len(latency_ms) / elapsed_s, quantiles(latency_ms), stage_ms,
                    core_s / elapsed_s, 1e3 * core_s / frames, 1e3 * waited_s / frames,
                    *memory_mb(process_id), start_s, start_core_s)

    def _wait_for_node(self, process_id: int) -> tuple[float, float]:
        """Return how long it took until the node had subscribed, and its time on a core."""
        deadline_s = time.monotonic() + _START_TIMEOUT_S
        while not all(p.get_subscription_count() for p in self._publishers.values()):
            if time.monotonic() > deadline_s:
                raise RuntimeError(f'the node was not active within {_START_TIMEOUT_S:g} s')
            self._spin(_SPIN_S)
        taken = age_seconds(process_id), core_seconds(process_id)
        while self._receiver.outputs and not self._node.count_subscribers(f'{NODE}/planes'):
            self._spin(_SPIN_S)
        return taken

    def _spin(self, seconds: float) -> float:
        """Spin for some time; return the actual duration in seconds."""
        start_s = time.monotonic()
        while (elapsed_s := time.monotonic() - start_s) < seconds:
            self._check_running()
            self._executor.spin_once(timeout_sec=_SPIN_S)
        return elapsed_s

    def _publish(self) -> None:
        stamp = self._node.get_clock().now().to_msg()
        view = self._views[int(self._sent / self._rate_hz / HELD_S) % len(self._views)]
        image = view[self._sent % len(view)]
        self._sent += 1
        for name, publisher in self._publishers.items():
            image[name].header.stamp = stamp
            publisher.publish(image[name])

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        self._statuses += [{pair.key: pair.value for pair in status.values}
                           for status in msg.status if status.name == NODE]


def input_messages(header: Header, view: Frame) -> dict[str, Any]:
    """Return the messages that a camera publishes for a view, by topic; the image comes last."""
    return {'camera_info': camera_info_to_msg(header, view.intrinsics),
            'depth': messages.depth_to_msg(header, view.depth_m),
            'image': messages.rgb_to_msg(header, view.rgb)}


def _moved(view: Frame, shift_px: int) -> Frame:
    """Return a view moved sideways; what leaves the image comes in at the other side."""
    return replace(view, rgb=np.roll(view.rgb, shift_px, axis=1),
                   depth_m=np.roll(view.depth_m, shift_px, axis=1))


def median_stages(statuses: Sequence[dict[str, str]]) -> dict[str, float]:
    """Return the median of each stage's time in milliseconds over the seconds with frames."""
    told = [{key.removeprefix('latency.').removesuffix('_ms'): float(value)
             for key, value in status.items() if key.startswith('latency.')}
            for status in statuses]
    told = [stages for stages in told if len(stages) > 1]  # without frames there is but a total
    return {stage: float(np.median([stages[stage] for stages in told]))
            for stage in (told[-1] if told else {})}


def quantiles(latency_ms: Sequence[float]) -> np.ndarray:
    """Return the median, the 95 % quantile and the largest of some times; NaN for none."""
    return np.quantile(latency_ms, (0.5, 0.95, 1.0)) if len(latency_ms) else np.full(3, np.nan)


def age_seconds(process_id: int) -> float:
    """Return the time since the start of a process; Linux only."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) - _ticks(process_id)[19] * _TICK_S


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


def memory_mb(process_id: int) -> tuple[float, float]:
    """Return VmRSS and Pss of a process in MB; Linux only."""
    rows = [line.split() for file in ('status', 'smaps_rollup')
            for line in Path(f'/proc/{process_id}/{file}').read_text().splitlines()]
    kilobytes = {row[0]: row[1] for row in rows if len(row) == 3}
    return tuple(int(kilobytes[name]) * 1024 / 1e6 for name in ('VmRSS:', 'Pss:'))
