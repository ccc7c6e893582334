# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Client of the node: publishes images like a camera and subscribes to the outputs."""

from __future__ import annotations

import array
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from plane_detector.tools.demo.photographs import Photograph
from plane_detector.types import CameraIntrinsics

NODE = 'plane_detector'
FRAME_ID = 'camera_optical_frame'
_INPUTS = {'image': Image, 'depth': Image, 'camera_info': CameraInfo}
_OUTPUTS = {'points': PointCloud2, 'planes': PointCloud2, 'depth': Image, 'overlay': Image}
_RELIABLE = QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE)
_NUMPY_TYPES = {PointField.FLOAT32: '<f4', PointField.UINT32: '<u4', PointField.UINT8: 'u1'}
_SPIN_S = 0.02
_INTRODUCTION_S = 0.2
_PATIENCE_S = 10.0  # a large network on a busy machine takes several seconds


@dataclass(frozen=True)
class Received:
    """
    Messages that the node published for one image.

    Attributes
    ----------
    points : (H, W) structured
        Fields of ``~/points``.
    planes : (N,) structured
        Fields of ``~/planes``.
    depth_m : (H, W) float32
        Of ``~/depth``.
    overlay : (H, W, 3) uint8
        Of ``~/overlay``.

    """

    points: np.ndarray
    planes: np.ndarray
    depth_m: np.ndarray
    overlay: np.ndarray


@dataclass
class Timing:
    """Frames and seconds of a run, and the diagnostics during it."""

    frames: int = 0
    seconds: float = 0.0
    statuses: list[dict[str, str]] = field(default_factory=list)

    @property
    def rate_hz(self) -> float:
        """Frames per second with one frame in flight at a time."""
        return self.frames / self.seconds

    def stage_ms(self) -> dict[str, float]:
        """Return the mean time of each stage, as reported by the node."""
        told = [{key.removeprefix('latency.').removesuffix('_ms'): float(value)
                 for key, value in status.items() if key.startswith('latency.')}
                for status in self.statuses]
        told = [stages for stages in told if len(stages) > 1]  # without seconds that had no frame
        return {stage: float(np.mean([stages.get(stage, 0.0) for stages in told]))
                for stage in (told[-1] if told else {})}


class NodeClient:
    """
    A ROS node that sends images to the plane detector and collects its outputs.

    Parameters
    ----------
    check_running : callable
        Raises if the plane detector has ended; called while waiting.
    inputs : sequence of str
        Topics that the plane detector subscribes to.

    """

    def __init__(self, check_running: Callable[[], None], inputs: Sequence[str]) -> None:
        self._check_running = check_running
        self._node = rclpy.create_node('plane_detector_demo')
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._messages: dict[str, Any] = {}
        self._scene: Photograph | None = None
        self._timing = Timing()
        self._publishers = {
            name: self._node.create_publisher(_INPUTS[name], name, _RELIABLE) for name in inputs}
        for name, msg_type in _OUTPUTS.items():
            self._node.create_subscription(
                msg_type, f'{NODE}/{name}', lambda msg, name=name: self._take(name, msg),
                _RELIABLE)
        self._reset = self._node.create_client(Trigger, f'{NODE}/reset_tracking')
        self._node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)

    def close(self) -> None:
        """Destroy the ROS node."""
        self._executor.shutdown()
        self._node.destroy_node()

    def wait_until_ready(self, timeout_s: float, tick: Callable[[], None]) -> None:
        """
        Wait until the node has subscribed to its inputs and advertised its outputs.

        Raises
        ------
        TimeoutError, RuntimeError
            The time is over; the node has ended.

        """
        self._spin_until(self._connected, timeout_s, 'the node did not become active', tick)

    def process(self, photograph: Photograph, timeout_s: float) -> Received:
        """
        Publish an image once and return the outputs with its stamp.

        If ``depth`` is one of the inputs, the true depth of the image is published too.

        Raises
        ------
        TimeoutError, RuntimeError
            Not all outputs arrived in time; the node has ended, or could not process the image.

        """
        self._messages.clear()
        if photograph is not self._scene:
            self._introduce(photograph, timeout_s)
        sent: list[Any] = []
        deadline_s = time.monotonic() + timeout_s
        while not self._complete(sent):
            # Repeated, because outputs whose subscribers are not discovered yet are not made.
            sent.append(self._send(photograph))
            self._spin_until(
                lambda: self._complete(sent), deadline_s - time.monotonic(),
                f'the results for {photograph.name} did not come', lambda: None,
                patience_s=_PATIENCE_S)
        return _decoded(self._messages)

    def _send(self, photograph: Photograph) -> Any:
        """Publish an image with calibration, and depth if it is an input; return its stamp."""
        header = Header(frame_id=FRAME_ID, stamp=self._node.get_clock().now().to_msg())
        self._publishers['camera_info'].publish(camera_info_to_msg(header, photograph.intrinsics))
        if 'depth' in self._publishers:
            self._publishers['depth'].publish(_image(header, '32FC1', photograph.true_depth_m))
        self._publishers['image'].publish(_image(header, 'rgb8', photograph.rgb))
        return header.stamp

    def _introduce(self, photograph: Photograph, timeout_s: float) -> None:
        """Start a new scene: its CameraInfo arrives before its first image; labels are reset."""
        header = Header(frame_id=FRAME_ID, stamp=self._node.get_clock().now().to_msg())
        self._publishers['camera_info'].publish(camera_info_to_msg(header, photograph.intrinsics))
        self._publishers['camera_info'].wait_for_all_acked(Duration(seconds=timeout_s))
        time.sleep(_INTRODUCTION_S)  # acknowledged messages may still be queued behind others
        answer = self._reset.call_async(Trigger.Request())
        self._spin_until(answer.done, timeout_s, f'{self._reset.srv_name} did not answer',
                         lambda: None)
        self._scene = photograph

    def measure(self, photograph: Photograph, seconds: float, timeout_s: float,
                tick: Callable[[], None]) -> Timing:
        """Publish the image repeatedly, each time after the results of the previous one."""
        self._timing = timing = Timing()
        start_s = time.monotonic()
        while timing.seconds < seconds:
            self.process(photograph, timeout_s)
            timing.frames += 1
            timing.seconds = time.monotonic() - start_s
            tick()
        return timing

    def _take(self, name: str, msg: Any) -> None:
        self._messages[name] = msg

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        self._timing.statuses += [{pair.key: pair.value for pair in status.values}
                                  for status in msg.status if status.name == NODE]

    def _skipped(self) -> str:
        """Return why frames were skipped; empty if none was."""
        latest = self._timing.statuses[-1:] or [{}]
        return latest[0]['last_error'] if int(latest[0].get('frames_skipped', 0)) else ''

    def _connected(self) -> bool:
        return (all(p.get_subscription_count() for p in self._publishers.values())
                and self._reset.service_is_ready()
                and all(self._node.count_publishers(f'{NODE}/{name}') for name in _OUTPUTS))

    def _complete(self, sent: Sequence[Any]) -> bool:
        stamps = [self._messages[name].header.stamp for name in _OUTPUTS if name in self._messages]
        return len(stamps) == len(_OUTPUTS) and any(
            all(stamp == one for stamp in stamps) for one in sent)

    def _spin_until(self, done: Callable[[], bool], timeout_s: float, problem: str,
                    tick: Callable[[], None], patience_s: float = float('inf')) -> None:
        """Spin until done, or until patience is over; raises after the timeout."""
        start_s = time.monotonic()
        deadline_s = start_s + timeout_s
        while not done() and time.monotonic() < start_s + patience_s:
            self._check_running()
            if skipped := self._skipped():
                raise RuntimeError(f'the node skips the frames: {skipped}')
            if time.monotonic() > deadline_s:
                raise TimeoutError(f'{problem} within {timeout_s:g} s')
            self._executor.spin_once(timeout_sec=_SPIN_S)
            tick()


def cloud_from_msg(msg: PointCloud2) -> np.ndarray:
    """Return a cloud as a structured array: (H, W), or (N,) if it is not organised."""
    names = [point_field.name for point_field in msg.fields]
    dtype = np.dtype({'names': names, 'itemsize': msg.point_step,
                      'formats': [_NUMPY_TYPES[f.datatype] for f in msg.fields],
                      'offsets': [f.offset for f in msg.fields]})
    cloud = np.frombuffer(msg.data, dtype)
    return cloud.reshape(msg.height, msg.width) if msg.height > 1 else cloud


def _decoded(messages: dict[str, Any]) -> Received:
    depth, overlay = messages['depth'], messages['overlay']
    return Received(
        cloud_from_msg(messages['points']), cloud_from_msg(messages['planes']),
        np.frombuffer(depth.data, '<f4').reshape(depth.height, depth.width),
        np.frombuffer(overlay.data, np.uint8).reshape(overlay.height, overlay.width, 3))


def _image(header: Header, encoding: str, pixels: np.ndarray) -> Image:
    data = array.array('B')
    data.frombytes(np.ascontiguousarray(pixels).data.cast('B'))
    msg = Image(header=header, height=pixels.shape[0], width=pixels.shape[1], encoding=encoding,
                step=len(data) // pixels.shape[0])
    msg.data = data
    return msg


def camera_info_to_msg(header: Header, i: CameraIntrinsics) -> CameraInfo:
    """Return the CameraInfo of a pinhole camera."""
    return CameraInfo(
        header=header, width=i.width, height=i.height, distortion_model='plumb_bob', d=[0.0] * 5,
        k=[i.fx, 0.0, i.cx, 0.0, i.fy, i.cy, 0.0, 0.0, 1.0],
        r=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p=[i.fx, 0.0, i.cx, 0.0, 0.0, i.fy, i.cy, 0.0, 0.0, 0.0, 1.0, 0.0])
