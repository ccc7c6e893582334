# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The node with good, bad, late, distorted and too many inputs."""


import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from node_helpers import CAMERA, send, start
from onnx_models import network_parameters, write_depth_network
from ros_helpers import camera_info_msg, header, image_msg
from sensor_msgs.msg import CompressedImage


@pytest.fixture
def robot(robot, monkeypatch):
    """Return it with statuses a second apart: each warns of what came since the one before."""
    monkeypatch.setattr('plane_detector.ros.diagnostics._PERIOD_S', 1.0)
    return robot


def bad_frames(room):
    """Yield a name, a message and what the log must say of it."""
    yield 'encoding', image_msg(room.rgb, 'rgb32', 2.0), 'rgb32'
    short = image_msg(room.rgb, 'rgb8', 2.0)
    short.data = short.data[:-10]
    yield 'data', short, 'height x step'
    yield 'size', image_msg(room.rgb[:100], 'rgb8', 2.0), '320 x 100'


def test_bad_frames_are_logged_and_skipped(robot, room):
    start(robot, lambda rgb: room.depth_m)
    robot.publish('camera_info', camera_info_msg(CAMERA, 2.0))
    frames = list(bad_frames(room))
    for name, msg, reason in frames:
        robot.publish('image', msg)
        assert robot.is_logged(reason), name

    def counted():  # a status may have been sent between the log and the count
        return [(status.level, values) for message in robot.received['diagnostics']
                for status in message.status[:1]
                if (values := {value.key: value.value for value in status.values}).get(
                    'frames_skipped') == str(len(frames))]
    assert robot.spin(counted)
    level, values = counted()[0]
    assert '320 x 100' in values['last_error']
    assert level == DiagnosticStatus.WARN
    assert not robot.received['planes']
    send(robot, room, 3.0)
    assert robot.wait_for('planes')[0].header == header(3.0)


def test_a_network_without_depth_is_reported_for_each_frame(robot, room, tmp_path):
    path = write_depth_network(tmp_path / 'n.onnx', height=48, width=64, weights=(1, 0, 0))
    start(robot, **network_parameters(path))
    robot.publish('camera_info', camera_info_msg(CAMERA, 1.0))
    without_red = room.rgb * np.array([0, 1, 1], np.uint8)
    without_red[::2] //= 2
    robot.publish('image', image_msg(without_red, 'rgb8', 1.0))
    assert robot.is_logged('n.onnx: its output is zero everywhere')

    def errors():  # one status warns, which may have been sent before the log was read
        return [pair.value for message in robot.received['diagnostics']
                for status in message.status[:1] if status.level == DiagnosticStatus.WARN
                for pair in status.values if pair.key == 'last_error']
    assert robot.spin(errors)
    assert 'n.onnx: its output is zero everywhere' in errors()[-1]
    send(robot, room, 2.0)
    assert robot.wait_for('planes')[0].header == header(2.0)


def test_compressed_transport(robot, room):
    images = []

    def estimate(rgb):
        images.append(rgb)
        return room.depth_m

    start(robot, estimate, image_transport='compressed')
    _, data = cv2.imencode('.jpg', room.rgb[..., ::-1])
    msg = CompressedImage(header=header(4.0), format='jpg', data=data.tobytes())
    robot.publish('camera_info', camera_info_msg(CAMERA, 4.0))
    robot.publish('image/compressed', msg)
    assert robot.wait_for('planes')[0].header == header(4.0)
    assert np.abs(images[0].astype(int) - room.rgb).mean() < 4


@pytest.mark.parametrize('wrong_px', [1e308, 10.0])
def test_a_calibration_out_of_reason_is_refused_and_the_next_good_image_gives_planes(
        robot, room, wrong_px):
    """With tracking on, as it is: products of 1e308 overflow to NaN in the scores of its pairs."""
    start(robot, lambda rgb: room.depth_m)
    for stamp_s, focal_px in enumerate((CAMERA.fx, wrong_px, CAMERA.fx)):
        info = camera_info_msg(CAMERA, stamp_s)
        info.k[0] = info.p[0] = focal_px
        robot.publish('camera_info', info)
        robot.settle()  # an image that comes first is processed with the one before
        robot.publish('image', image_msg(room.rgb, 'rgb8', stamp_s))
        assert robot.spin(lambda: robot.received['planes']) if focal_px == CAMERA.fx else (
            robot.is_logged(f'fx {wrong_px:g} px cannot be that of a 320 x 240 image, 28.16 to '
                            '320000 px'))
    assert robot.wait_for('planes', 2)[1].header == header(2.0)


def test_a_jump_back_in_time_is_survived_and_logged(robot, room):
    start(robot, lambda rgb: room.depth_m)
    send(robot, room, 100.0)
    robot.wait_for('planes')
    send(robot, room, 5.0)
    assert robot.wait_for('planes', 2)[1].header == header(5.0)
    send(robot, room, 5.1)
    robot.wait_for('planes', 3)
    assert robot.log().count('time jumped back') == 1
