# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""One field at a time has an extreme value, between good frames: the next one is answered."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from common import CAMERA, FedNode, Row, fed_node
from field_faults import REALS, camera_infos, clicks, depths, images, imus
from geometry_msgs.msg import PointStamped
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from ros_helpers import camera_info_msg, header, image_msg
from sensor_msgs.msg import Imu, PointCloud2

from plane_detector.config import Config, NodeConfig
from plane_detector.evaluation.scenes.rooms import random_room
from plane_detector.settings import parameters_of

WITHIN_S, GIVEN_UP_S = 1.0, 20.0
GOOD_FRAMES = 20
ARGUMENTS = ['-p', 'depth.source:=topic', '-p', 'use_imu:=true']
# The method takes seconds for a frame.
PAPER = 'paper'
DISTORTION = [-0.2, 0.05, 0.0, 0.0, 0.0]


class Camera:
    """Sends the frames of a room to a node, and measures the time until one is answered."""

    def __init__(self, node: FedNode):
        self._robot, self._stamp_s = node.robot, 1.0
        self._room = random_room(np.random.default_rng(3), CAMERA)
        self._robot.listen(PointCloud2, 'plane_detector/planes', 'planes')

    def frame(self) -> dict[str, Any]:
        """Return the messages of the next frame by topic."""
        self._stamp_s += 0.1
        imu = Imu(header=header(self._stamp_s))
        force = imu.linear_acceleration
        force.x, force.y, force.z = (-9.81 * self._room.gravity_camera).tolist()
        return {'camera_info': camera_info_msg(CAMERA, self._stamp_s), 'imu': imu,
                'depth': image_msg(self._room.depth_m, '32FC1', self._stamp_s),
                'image': image_msg(self._room.rgb, 'rgb8', self._stamp_s)}

    def send(self, messages: dict[str, Any]) -> None:
        """Publish messages, and leave the node the time to take them."""
        for topic, msg in messages.items():
            self._robot.publish(topic, msg)
        self._robot.spin(timeout_s=0.02)

    def seconds_to_answer(self) -> float:
        """Send good frames, four a second, until one is answered; infinite if none is."""
        start_s, seen, good = time.monotonic(), self._robot.received['planes'], []
        while time.monotonic() - start_s < GIVEN_UP_S:
            messages = self.frame()
            good.append(messages['image'].header.stamp)
            self.send(messages)
            if self._robot.spin(lambda: any(msg.header.stamp in good for msg in seen), 0.25):
                seen.clear()
                return time.monotonic() - start_s
        return float('inf')


def fields(folder: Path) -> list[Row]:
    """Return how soon a good frame is answered after messages of one odd field each."""
    with fed_node(folder, ARGUMENTS) as node:
        assert node.wait_for_state('active'), node.node.log()
        camera = Camera(node)
        for _ in range(GOOD_FRAMES):  # both ends find each other, the last loops are loaded
            camera.seconds_to_answer()
        groups = {'nothing': iter(GOOD_FRAMES * [('', lambda: None)]),
                  'a CameraInfo': _odd(camera, 'camera_info', camera_infos),
                  'a CameraInfo with distortion': _odd(camera, 'camera_info', camera_infos,
                                                       DISTORTION),
                  'an image': _odd(camera, 'image', images),
                  'a depth image': _odd(camera, 'depth', depths),
                  'an IMU reading': _odd(camera, 'imu', imus),
                  'a clicked point': _clicks(camera),
                  'a parameter': _parameters(node, camera)}
        return [_row(node, camera, name, cases) for name, cases in groups.items()]


def _row(node: FedNode, camera: Camera, name: str,
         cases: Iterator[tuple[str, Callable[[], None]]]) -> Row:
    """Do something odd, then send a good frame, for each case."""
    count, slowest, begun_s = 0, (0.0, ''), time.monotonic()
    for case, do in cases:
        count += 1
        do()
        slowest = max(slowest, (camera.seconds_to_answer(), case))
        if node.node.process.poll() is not None or slowest[0] == float('inf'):
            break
    log = node.node.log()
    traces = log.count('Traceback') + log.count('raised at')
    return Row(f'{count} times {name} with one odd value, {time.monotonic() - begun_s:.0f} s',
               f'the next good frame is answered within {WITHIN_S:.0f} s, no error but ValueError',
               f'slowest {slowest[0]:.2f} s, {slowest[1]}; {traces} tracebacks so far',
               slowest[0] <= WITHIN_S and not traces)


def _odd(camera: Camera, topic: str, vary: Callable[[Any], Iterator[tuple[str, Any]]],
         distortion: list[float] | None = None) -> Iterator[tuple[str, Callable[[], None]]]:
    """Yield frames of which one message has an odd field."""
    first = camera.frame()[topic]
    if distortion:
        first.d = distortion
    for case, msg in vary(first):
        frame = camera.frame()
        if msg.header.stamp == first.header.stamp:
            msg.header.stamp = frame[topic].header.stamp
        yield case, lambda sent={**frame, topic: msg}: camera.send(sent)


def _clicks(camera: Camera) -> Iterator[tuple[str, Callable[[], None]]]:
    point = PointStamped(header=header(1.0))
    for case, msg in clicks(point):
        yield case, lambda msg=msg: camera.send({'clicked_point': msg})


def set_parameters(node: FedNode, values: dict[str, Any]) -> None:
    """Set parameters, which may be refused."""
    parameters = [Parameter(name, value=list(value) if isinstance(value, tuple) else value
                            ).to_parameter_msg() for name, value in values.items()]
    node.robot.call(SetParameters, 'plane_detector/set_parameters',
                    SetParameters.Request(parameters=parameters))


def _parameters(node: FedNode, camera: Camera) -> Iterator[tuple[str, Callable[[], None]]]:
    """Yield changes of one parameter, a frame, and its value before."""
    choices = {str: ('', 'auto', 'all', '\x1b[2J', 'x' * 10_000), bool: (True, False),
               int: (0, -1, 1, 2**31, 2**62), float: REALS}
    for config in (Config(), NodeConfig()):
        for name, field, value in parameters_of(config):
            kind = type(value[0]) if isinstance(value, tuple) else type(value)
            for odd in {*field.metadata['choices'], *choices[kind]} - {PAPER}:
                new = [odd] * len(value) if isinstance(value, tuple) else odd

                def change(name=name, new=new, value=value):
                    set_parameters(node, {name: new})
                    camera.send(camera.frame())
                    set_parameters(node, {name: value})
                yield f'{name} = {str(odd)[:20]!r}', change
