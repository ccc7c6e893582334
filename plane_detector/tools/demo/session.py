# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The node and a simulated camera in one process, connected by their topics."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from plane_detector._runtime.stopping import raise_if_stopped
from plane_detector.ros.calibration import camera_info_to_msg
from plane_detector.ros.detector_node import PlaneDetectorNode
from plane_detector.ros.inputs.depth_decoding import depth_from_msg
from plane_detector.ros.outputs.messages import depth_to_msg, read_cloud, rgb_to_msg
from plane_detector.tools.demo.photographs import Photograph
from plane_detector.tools.private_domain import private_domain
from plane_detector.types import RELATIVE

_INPUTS = {'camera_info': CameraInfo, 'depth': Image, 'image': Image}
_OUTPUTS = {'points': PointCloud2, 'planes': PointCloud2, 'depth': Image}
_START_S, _FRAME_S = 600.0, 60.0  # the first start compiles and downloads
_INTRODUCTION_S = 0.3
_PERIOD_S = 0.3  # at a higher rate, the pause between photographs would count as lost images
_MEASURED_FRAMES = 10


@dataclass(frozen=True)
class Received:
    """What the node published for one image: (H, W) and (N,) structured, (H, W) float32."""

    points: np.ndarray
    planes: np.ndarray
    depth_m: np.ndarray
    unit: str
    frame_ms: float
    note: str  # why the image does not give gravity; empty if it does


class Session:
    """
    A node with these parameters, which is fed with photographs; a context manager.

    Raises
    ------
    TimeoutError, CannotRunError
        The node does not become active.

    """

    def __init__(self, parameters: Mapping[str, Any]) -> None:
        self._context = rclpy.Context()
        # A new one each time: there, the node of the previous session is still known for a while.
        rclpy.init(context=self._context, domain_id=private_domain(),
                   signal_handler_options=SignalHandlerOptions.NO)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._camera = Node('demo', context=self._context)
        self._detector = PlaneDetectorNode(context=self._context, parameter_overrides=[
            Parameter(name, value=value)
            for name, value in {**parameters, 'exit_on_failure': True}.items()])
        for node in (self._camera, self._detector):
            self._executor.add_node(node)
        self._messages: dict[str, Any] = {}
        self._facts: dict[str, str] = {}
        self._publishers = {name: self._camera.create_publisher(kind, name, 5)
                            for name, kind in _INPUTS.items()}
        for name, kind in _OUTPUTS.items():
            self._camera.create_subscription(
                kind, f'plane_detector/{name}',
                lambda msg, name=name: self._messages.update({name: msg}), 5)
        self._camera.create_subscription(DiagnosticArray, '/diagnostics', self._note, 5)
        self._reset = self._camera.create_client(Trigger, 'plane_detector/reset_tracking')

    def __enter__(self) -> Session:
        try:
            self._spin_until(
                lambda: (self._detector.state == 'active' and self._reset.service_is_ready()
                         and self._publishers['image'].get_subscription_count()
                         and all(self._camera.count_publishers(f'plane_detector/{name}')
                                 for name in _OUTPUTS)),
                _START_S, 'the node did not become active')
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        for node in (self._camera, self._detector):
            node.destroy_node()
        self._executor.shutdown()
        self._context.try_shutdown()

    def process(self, photograph: Photograph) -> Received:
        """
        Publish a photograph, and its depth if known, and return the results of the node.

        Raises
        ------
        TimeoutError
            The outputs did not arrive; the log of the node says why.

        """
        self._spin_until(self._reset.call_async(Trigger.Request()).done, _FRAME_S,
                         'the node does not answer')
        self._publish(photograph, ('camera_info',))  # before the first image of another camera
        self._spin(_INTRODUCTION_S)
        self._send(photograph)  # outputs with new subscribers are not made yet
        seconds = []
        for _ in range(_MEASURED_FRAMES):
            start_s = time.perf_counter()
            self._send(photograph)
            seconds.append(time.perf_counter() - start_s)
            self._spin(_PERIOD_S - seconds[-1])
        self._facts.clear()
        self._spin_until(lambda: 'scale' in self._facts, _FRAME_S, 'no diagnostics arrived')
        return Received(
            read_cloud(self._messages['points']), read_cloud(self._messages['planes']).ravel(),
            depth_from_msg(self._messages['depth'], photograph.rgb[..., 0].size),
            'units' if self._facts['scale'] == RELATIVE else 'm', 1e3 * float(np.median(seconds)),
            f"; {self._facts['gravity_note']}" if 'gravity_note' in self._facts else '')

    def _send(self, photograph: Photograph) -> None:
        """Publish once and wait for all outputs of this image."""
        stamp = self._publish(photograph, tuple(_INPUTS)).stamp
        self._spin_until(
            lambda: all(name in self._messages and self._messages[name].header.stamp == stamp
                        for name in _OUTPUTS),
            _FRAME_S, f'the results for {photograph.name} did not arrive')

    def _publish(self, photograph: Photograph, names: tuple[str, ...]) -> Header:
        """Publish a photograph's messages of these names; return their header."""
        header = Header(frame_id='camera_optical_frame',
                        stamp=self._camera.get_clock().now().to_msg())
        messages = {'camera_info': camera_info_to_msg(header, photograph.intrinsics),
                    'image': rgb_to_msg(header, photograph.rgb)}
        if photograph.true_depth_m is not None:
            messages['depth'] = depth_to_msg(header, photograph.true_depth_m)
        for name in names:
            if name in messages:
                self._publishers[name].publish(messages[name])
        return header

    def _note(self, msg: DiagnosticArray) -> None:
        for status in msg.status:
            self._facts.update({pair.key: pair.value for pair in status.values})

    def _spin_once(self) -> None:
        self._executor.spin_once(timeout_sec=0.02)
        raise_if_stopped()

    def _spin(self, seconds: float) -> None:
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self._spin_once()

    def _spin_until(self, done: Callable[[], Any], timeout_s: float, problem: str) -> None:
        end_s = time.monotonic() + timeout_s
        while not done():
            if time.monotonic() > end_s:
                raise TimeoutError(f'{problem} within {timeout_s:g} s; its log says why')
            self._spin_once()
