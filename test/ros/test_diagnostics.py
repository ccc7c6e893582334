# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Missing inputs are reported in the diagnostics and once in the log."""

from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from node_helpers import send, small_room, start

from plane_detector.depth.observation import DepthFunction
from plane_detector.evaluation.scenes.rooms import random_room
from plane_detector.evaluation.scenes.textures import textured
from plane_detector.ros.diagnostics import FLOORLESS, Health, Report, gap_of


def detection(classes, scale='metric', planes=2, gravity_note='', shape=(480, 640)):
    return SimpleNamespace(labels=np.zeros(shape), planes=(None,) * planes, classes=classes,
                           scale_method=scale, scale_note='why', scale_event='',
                           gravity_source='none', gravity_note=gravity_note,
                           gravity_probability=float('nan'),
                           camera_height_m=1.25, tilt_deg=float('nan'), drops_m=(),
                           drop_note='', disparity_noise=0.002, systematic_noise=0.001)


@pytest.mark.parametrize('found, wanted, told', [
    (detection((1, 3)), (FLOORLESS,), ''),
    (detection((), planes=0), (FLOORLESS,), ''),
    (detection((0, 0)), ('planes',), 'the direction of gravity is not known'),
    (detection((0, 0)), (FLOORLESS,), 'points_without_floor is silent'),
    (detection((0, 0), gravity_note='only 3 straight lines'), (), 'not known (only 3 straight'),
    (detection((0, 0), 'relative'), ('planes',), 'neither metres nor gravity'),
    (detection((1, 0), 'relative'), ('planes',), ''),
    (detection((1, 0), 'relative'), (FLOORLESS,), 'the unit of depth is not known (why)')])
def test_gaps(found, wanted, told):
    gap = gap_of(found, wanted)
    assert told in gap
    assert bool(told) == bool(gap)


def test_each_gap_is_logged_once_and_cleared_when_it_ends():
    lines = []
    health = Health(SimpleNamespace(warning=lines.append, info=lines.append))
    for _ in range(3):
        health.note(detection((0, 0)), ())
        level, message = health.status(Report(3, 0, 0, 1.0), '')
        assert level == DiagnosticStatus.WARN
        assert 'gravity' in message
    assert len(lines) == 1
    health.note(detection((1, 3)), ())
    assert health.status(Report(4, 0, 0, 1.0), '') == (DiagnosticStatus.OK, 'active')


def test_a_silent_imu_is_reported(robot):
    room = small_room()
    start(robot, lambda rgb: room.depth_m, use_imu=True)
    for stamp_s in np.arange(1.0, 6.0, 0.25):
        send(robot, room, stamp_s)
        robot.spin(timeout_s=0.1)
    assert robot.is_logged('nobody publishes /imu')
    status, _ = robot.diagnosis()
    assert status.level == DiagnosticStatus.WARN
    assert '/imu' in status.message


def test_the_probability_of_the_vertical_of_the_image_is_told(robot):
    room = textured(random_room, 300)
    start(robot, lambda rgb: room.depth_m)
    send(robot, room)
    assert robot.spin(lambda: robot.diagnosis()[1].get('gravity') == 'image')
    assert 0.9 <= float(robot.diagnosis()[1]['gravity_probability']) <= 1


def test_it_is_not_told_of_other_sources(robot):
    room = small_room()
    start(robot, lambda rgb: room.depth_m, scale__gravity=room.gravity_camera.tolist())
    send(robot, room)
    assert robot.spin(lambda: robot.diagnosis()[1].get('gravity') == 'parameter')
    assert 'gravity_probability' not in robot.diagnosis()[1]


def test_without_a_unit_no_drops_are_told_and_why(robot):
    room = small_room()
    start(robot, DepthFunction(lambda rgb: 1 / room.depth_m, 'relative_disparity'),
          scale__gravity=room.gravity_camera.tolist())
    send(robot, room)
    assert robot.wait_for('planes')
    assert robot.spin(lambda: robot.diagnosis()[1].get('drops', '').startswith('none told: '))
    assert not robot.received['drops'] and not robot.received['ground']
