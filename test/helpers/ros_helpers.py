# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Messages, a camera with subscribers and the node as a process, for the tests of the ROS side."""

from __future__ import annotations

import array
import os
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray, TransformStamped
from rclpy.executors import SingleThreadedExecutor, TimeoutException
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from plane_detector.tools.private_domain import private_domain
from plane_detector.types import CameraIntrinsics

OUTPUT_TYPES = {'points': PointCloud2, 'points_without_floor': PointCloud2, 'planes': PointCloud2,
                'labels': Image, 'depth': Image, 'overlay': Image, 'plane_poses': PoseArray,
                'markers': MarkerArray}

FRAME_ID = 'camera_optical_frame'


def header(stamp_s: float = 0.0) -> Header:
    """Return a header of the camera with a stamp."""
    result = Header(frame_id=FRAME_ID)
    stamp_ns = round(stamp_s * 1e9)
    result.stamp.sec, result.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
    return result


def image_msg(pixels: np.ndarray, encoding: str, stamp_s: float = 0.0, padding: int = 0,
              big_endian: bool = False) -> Image:
    """Return pixels (H, W[, C]) as an Image whose rows end with bytes of 255."""
    if big_endian:
        pixels = pixels.astype(pixels.dtype.newbyteorder('>'))
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=255)
    msg = Image(header=header(stamp_s), height=pixels.shape[0], width=pixels.shape[1],
                encoding=encoding, step=rows.shape[1], is_bigendian=int(big_endian))
    msg.data = array.array('B', rows.tobytes())
    return msg


def camera_info_msg(intrinsics: CameraIntrinsics, stamp_s: float = 0.0) -> CameraInfo:
    """Return the CameraInfo of a pinhole camera."""
    msg = CameraInfo(header=header(stamp_s), width=intrinsics.width, height=intrinsics.height,
                     distortion_model='plumb_bob', d=[0.0] * 5)
    msg.k = [intrinsics.fx, 0.0, intrinsics.cx, 0.0, intrinsics.fy, intrinsics.cy, 0.0, 0.0, 1.0]
    msg.r = np.eye(3).ravel().tolist()
    msg.p = np.pad(np.reshape(msg.k, (3, 3)), ((0, 0), (0, 1))).ravel().tolist()
    return msg


def transform_msg(parent, child, translation_m=(0.0, 0.0, 0.0), quaternion=(0.0, 0.0, 0.0, 1.0),
                  stamp_s=0.0):
    """Return the transform from a child into its parent, quaternion x y z w."""
    msg = TransformStamped(header=header(stamp_s), child_frame_id=child)
    msg.header.frame_id = parent
    position, rotation = msg.transform.translation, msg.transform.rotation
    position.x, position.y, position.z = translation_m
    rotation.x, rotation.y, rotation.z, rotation.w = quaternion
    return msg


def cloud_array(msg) -> np.ndarray:
    """Return a PointCloud2 as a structured array (height, width), read by its own fields."""
    types = {1: 'i1', 2: 'u1', 3: '<i2', 4: '<u2', 5: '<i4', 6: '<u4', 7: '<f4', 8: '<f8'}
    dtype = np.dtype({'names': [f.name for f in msg.fields],
                      'formats': [types[f.datatype] for f in msg.fields],
                      'offsets': [f.offset for f in msg.fields], 'itemsize': msg.point_step})
    assert not msg.is_bigendian
    assert msg.row_step == msg.width * msg.point_step
    assert len(msg.data) == msg.height * msg.row_step
    return np.frombuffer(msg.data, dtype).reshape(msg.height, msg.width)


def image_array(msg: Image, dtype: str, channels: int = 1) -> np.ndarray:
    """Return the pixels of an Image (H, W, channels) without padding."""
    return np.frombuffer(msg.data, dtype).reshape(msg.height, msg.width, channels)


@cache
def _domains() -> Iterator[int]:
    return cycle([private_domain() for _ in range(8)])


def next_domain() -> int:
    """Return a domain of DDS that no other process has, and no test shortly before had."""
    return next(_domains())


@contextmanager
def bare_node(name: str, arguments: tuple[str, ...] = (), **options: Any) -> Iterator[Node]:
    """Yield a node of rclpy in a context of its own, with arguments of ROS or overrides."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=next_domain())
    node = Node(name, context=context, cli_args=['--ros-args', *arguments], **options)
    try:
        yield node
    finally:
        node.destroy_node()
        context.try_shutdown()


class Robot:
    """A camera that publishes and subscribers that collect, with an executor to spin them."""

    def __init__(self, outputs=tuple(OUTPUT_TYPES), domain: int | None = None,
                 log_file: Path | None = None):
        self.log_file = log_file
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain or next_domain())
        self.executor = SingleThreadedExecutor(context=self.context)
        self.node = Node('robot', context=self.context)
        self.executor.add_node(self.node)
        self.received: dict[str, list[Any]] = defaultdict(list)
        self._publishers: dict[str, Any] = {}
        self._nodes = [self.node]
        for name in outputs:
            self.listen(OUTPUT_TYPES[name], f'plane_detector/{name}', name)
        self.listen(DiagnosticArray, '/diagnostics', 'diagnostics')

    def add(self, node: Node) -> None:
        """Spin a node along; it is destroyed with the robot."""
        self._nodes.append(node)
        self.executor.add_node(node)

    def listen(self, msg_type: Any, topic: str, name: str) -> None:
        """Collect the messages of a topic under a name."""
        self.node.create_subscription(msg_type, topic, self.received[name].append, 50)

    def publish(self, topic: str, msg: Any, qos: Any = 10) -> None:
        """Publish once the subscriber is matched, if there is going to be one."""
        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(type(msg), topic, qos)
            self.spin(lambda: self._publishers[topic].get_subscription_count() > 0, 3.0)
        self._publishers[topic].publish(msg)

    def settle(self) -> None:
        """
        Spin until the nodes have taken all that was sent before, however long this takes.

        Not what a thread of theirs is about to send.
        """
        with suppress(TimeoutException):  # nothing has come
            while True:
                callback, *_ = self.executor.wait_for_ready_callbacks(timeout_sec=0.02)
                callback()
                callback.result()  # its exception

    def spin(self, condition: Callable[[], Any] = lambda: False, timeout_s: float = 60.0) -> bool:
        """Spin until a condition holds; return whether it came to hold."""
        end_s = time.monotonic() + timeout_s
        while not (holds := bool(condition())) and time.monotonic() < end_s:
            self.executor.spin_once(timeout_sec=0.02)
        return holds  # what was seen: a second look could find the next state of the node

    def wait_for(self, name: str, count: int = 1) -> list[Any]:
        """Spin until so many messages have been received under a name, and return them."""
        assert self.spin(lambda: len(self.received[name]) >= count), (
            f'{len(self.received[name])} of {count} {name}; log: {self.log()}')
        return self.received[name]

    def call(self, srv_type: Any, name: str, request: Any = None) -> Any:
        """Call a service and return its response."""
        future = self.ask(srv_type, name, request)
        assert self.spin(future.done), f'no answer from {name}'
        return future.result()

    def ask(self, srv_type: Any, name: str, request: Any = None) -> Any:
        """Call a service and return the future of its response; the node has the call."""
        client = self.node.create_client(srv_type, name)
        assert self.spin(client.service_is_ready), f'no service {name}'
        future = client.call_async(request or srv_type.Request())
        self.settle()
        return future

    def is_logged(self, text: str) -> bool:
        """Spin until the nodes' log holds the text."""
        return self.spin(lambda: text in self.log())

    @contextmanager
    def log_in_file(self) -> Iterator[None]:
        """
        Append what goes to standard error to the log file; at the end show it there too.

        pytest's capfd truncates its file when read, and loses what a thread logs meanwhile.
        """
        before, before_fd = sys.stderr, os.dup(2)
        with self.log_file.open('a', buffering=1) as file:
            sys.stderr = file
            os.dup2(file.fileno(), 2)
            try:
                yield
            finally:
                sys.stderr = before
                os.dup2(before_fd, 2)
                os.close(before_fd)
        before.write(self.log())

    def log(self) -> str:
        """Return what the nodes have logged so far; with a log file only."""
        return self.log_file.read_text() if self.log_file else ''

    def diagnosis(self) -> tuple[Any, dict[str, str]]:
        """Return the first status that the node makes from now on, and its values."""
        self.settle()
        seen = len(self.received['diagnostics'])
        status = self.wait_for('diagnostics', seen + 1)[-1].status[0]
        return status, {value.key: value.value for value in status.values}

    def shutdown(self) -> None:
        """Destroy everything."""
        for node in self._nodes:
            node.destroy_node()
        self.executor.shutdown()
        self.context.try_shutdown()


ROOT = Path(__file__).resolve().parents[2]
STARTED_S = 120.0
# On a busy machine a node may take longer to end than it is given; its diagnostics come often.
PATIENT = """
import sys
from plane_detector._runtime import ending
from plane_detector.ros import diagnostics
ending.MOST_ENDING_S, diagnostics._PERIOD_S = 100.0, 0.25
from plane_detector.ros.node import main
sys.exit(main())
"""


class NodeProcess:
    """The node with these arguments, and what it printed; it has the time to end by itself."""

    def __init__(self, arguments, domain, log_path):
        path = os.pathsep.join([str(ROOT), os.environ.get('PYTHONPATH', '')]).rstrip(os.pathsep)
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain), 'PYTHONUNBUFFERED': '1',
                       'PYTHONPATH': path}
        self._log_path = log_path
        with open(log_path, 'wb') as log:
            self.process = subprocess.Popen(
                [sys.executable, '-c', PATIENT, '--ros-args', *arguments],
                env=environment, cwd=log_path.parent, stdout=log, stderr=subprocess.STDOUT)

    def log(self):
        return self._log_path.read_text(errors='replace')

    def wait_until(self, condition):
        end_s = time.monotonic() + STARTED_S
        while not condition():
            assert time.monotonic() < end_s, self.log()
            time.sleep(0.01)

    def end(self, number):
        """Send a signal and return the exit code."""
        self.process.send_signal(number)
        return self.process.wait(STARTED_S)
