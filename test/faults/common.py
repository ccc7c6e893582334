# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Shared code of the fault tests: table rows, resources of processes, a node with inputs."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from onnx_models import millimetres_as_rgb, network_arguments, write_depth_network
from ros_helpers import STARTED_S, NodeProcess, Robot, camera_info_msg, image_msg, next_domain

from plane_detector.evaluation.scenes.rooms import random_room
from plane_detector.ros.outputs.topics import OUTPUTS
from plane_detector.types import CameraIntrinsics

ROOT = Path(__file__).resolve().parents[2]
CAMERA = CameraIntrinsics(262.5, 262.5, 159.5, 119.5, 320, 240)


@dataclass(frozen=True)
class Row:
    """One fault."""

    fault: str  # what was done
    wanted: str
    measured: str
    good: bool  # the one is the other


def table(rows: list[Row]) -> str:
    """Return rows as Markdown."""
    lines = ['| Fault | Wanted | Measured | |', '|---|---|---|---|']
    lines += [f'| {row.fault} | {row.wanted} | {row.measured} | '
              f'{"ok" if row.good else "**fails**"} |' for row in rows]
    return '\n'.join(lines)


@dataclass(frozen=True)
class Usage:
    """Resources of a process: resident memory in MB, threads, open file descriptors."""

    memory_mb: float
    threads: int
    descriptors: int


def usage(pid: int) -> Usage:
    """Return the current resources of a process."""
    status = Path(f'/proc/{pid}/status').read_text(encoding='utf-8')
    fields = dict(line.split(':', 1) for line in status.splitlines())
    return Usage(int(fields['VmRSS'].split()[0]) / 1024, int(fields['Threads']),
                 len(os.listdir(f'/proc/{pid}/fd')))


def room_network(folder: Path, camera: CameraIntrinsics = CAMERA) -> list[str]:
    """Return the parameters for a network that reads depth out of the images of `rooms`."""
    return network_arguments(write_depth_network(folder / 'network.onnx', height=camera.height,
                                                 width=camera.width))


def rooms(count: int, camera: CameraIntrinsics = CAMERA) -> list[np.ndarray]:
    """Return images of rooms whose colours are their depth."""
    return [millimetres_as_rgb(random_room(np.random.default_rng(seed), camera).depth_m)
            for seed in range(count)]


class FedNode:
    """A node as a process, and a robot that feeds it and subscribes to all outputs."""

    def __init__(self, folder: Path, arguments: list[str], outputs: tuple[str, ...] = ()):
        os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'] = str(
            ROOT / 'config' / 'fastdds_large_messages.xml')
        domain = next_domain()
        self.robot = Robot(outputs=(), domain=domain)
        self.heard = dict.fromkeys(outputs, 0)
        for name in outputs:
            self.robot.node.create_subscription(
                OUTPUTS[name].msg_type, f'plane_detector/{name}', self._counting(name), 2)
        self.node = NodeProcess(arguments, domain, folder / 'node.log')
        self._stamp_s = 1.0

    def _counting(self, name: str) -> Callable[[object], None]:
        def count(_msg: object) -> None:
            self.heard[name] += 1
        return count

    @property
    def pid(self) -> int:
        """Of the node."""
        return self.node.process.pid

    def values(self) -> dict[str, str]:
        """Return the values of the last diagnostics."""
        received = self.robot.received['diagnostics']
        status = received[-1].status[0] if received else None
        del received[:-1]
        return {value.key: value.value for value in status.values} if status else {}

    def wait_for_state(self, state: str, timeout_s: float = STARTED_S) -> bool:
        """Spin until the diagnostics tell a state."""
        return self.robot.spin(lambda: self.values().get('state') == state, timeout_s)

    def feed(self, rgb: np.ndarray, camera: CameraIntrinsics = CAMERA,
             step_s: float = 1 / 30) -> None:
        """Publish an image with its calibration."""
        self._stamp_s += step_s
        self.robot.publish('camera_info', camera_info_msg(camera, self._stamp_s))
        self.robot.publish('image', image_msg(rgb, 'rgb8', self._stamp_s))

    def seconds_to_end(self, number: int) -> tuple[float, int | None]:
        """Send a signal; return the time until the process has ended, and its exit code."""
        start_s = time.monotonic()
        self.node.process.send_signal(number)
        while self.node.process.poll() is None and time.monotonic() - start_s < 20:
            time.sleep(0.01)
        return time.monotonic() - start_s, self.node.process.poll()

    def close(self) -> None:
        """Kill the node, and end the robot."""
        self.node.process.kill()
        self.node.process.wait()
        self.robot.shutdown()


@contextmanager
def fed_node(folder: Path, arguments: list[str],
             outputs: tuple[str, ...] = ()) -> Iterator[FedNode]:
    """Yield a node that is closed at the end."""
    node = FedNode(folder, arguments, outputs)
    try:
        yield node
    finally:
        node.close()
