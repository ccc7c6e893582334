# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Shapes requested of a running node whose machine has not compiled their loops."""

import threading

import pytest
from node_helpers import send, small_room, start
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from ros_helpers import header

from plane_detector.ros import live_settings
from plane_detector.shapes import detector


@pytest.fixture
def compiler(monkeypatch):
    """Return an event that ends the compiling of the shapes."""
    finished = threading.Event()

    def compile_slowly(subjects, tell, what='the loops'):
        if 'shapes' in subjects:
            tell(f'compiling {what}')
            finished.wait(60)

    monkeypatch.setattr(live_settings, 'compile_kernels', compile_slowly)
    monkeypatch.setattr(live_settings, 'are_ready', lambda subject: finished.is_set())
    yield finished
    finished.set()


def test_planes_are_found_while_the_loops_of_shapes_are_compiled(robot, monkeypatch, compiler):
    room, searched = small_room(), []
    find = detector.find_shapes
    monkeypatch.setattr(detector, 'find_shapes',
                        lambda *given: searched.append(compiler.is_set()) or find(*given))
    start(robot, lambda rgb: room.depth_m)
    wanted = [Parameter('shapes.types', value='all').to_parameter_msg()]
    request = SetParameters.Request(parameters=wanted)
    assert robot.call(SetParameters, 'plane_detector/set_parameters',
                      request).results[0].successful
    for stamp_s in (1.0, 2.0):
        send(robot, room, stamp_s)
        assert robot.wait_for('planes', int(stamp_s))[-1].header == header(stamp_s)
    assert robot.log().count('compiling the loops of shapes.types') == 1
    assert robot.diagnosis()[1]['shapes'] == 'their loops are being compiled'
    compiler.set()
    assert robot.spin(lambda: 'shapes' not in robot.diagnosis()[1])
    send(robot, room, 3.0)
    robot.wait_for('planes', 3)
    assert searched == [True]
