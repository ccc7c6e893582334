# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""If the scale is not known, no output claims metres."""

import re

import cv2
import numpy as np
import pytest
from node_helpers import CAMERA, send, small_room, start
from rclpy.parameter import Parameter

from plane_detector.depth.observation import DepthFunction
from plane_detector.evaluation.scenes.rooms import attic

LENGTH = re.compile(r'\d\s*(mm|cm|m|m2|met(re|er)s?)\b')
WORD = re.compile(r'\b(met(re|er)s?|metric)\b', re.IGNORECASE)
DENIALS = ('neither metres nor gravity are known',
           'metric: the network does not give metres', 'the network does not give metres')
ROOM = small_room()
ATTIC = attic(np.random.default_rng(1), CAMERA)  # without right angles but those of the gable


def claims(text):
    """Return the parts of a text that claim lengths in metres."""
    for denial in DENIALS:
        text = text.replace(denial, '')
    return [match.group() for pattern in (LENGTH, WORD) for match in pattern.finditer(text)]


def relative_network(scene):
    """Return a model that gives the true disparity, its scale and shift unknown."""
    disparity = 3.0 / scene.depth_m - 0.2
    return DepthFunction(lambda rgb: disparity, 'relative_disparity')


@pytest.fixture
def drawn(monkeypatch):
    """All the text that is drawn into images."""
    texts = []
    put_text = cv2.putText

    def recording(image, text, *arguments, **options):
        texts.append(text)
        return put_text(image, text, *arguments, **options)

    monkeypatch.setattr(cv2, 'putText', recording)
    return texts


def run(robot, scene, frames=3, **values):
    """Let a node see a scene some times; return it and the values of its diagnostics."""
    node = start(robot, relative_network(scene), **values)
    for stamp_s in range(1, frames + 1):
        send(robot, scene, stamp_s)
        robot.wait_for('markers', stamp_s)
        robot.wait_for('overlay', stamp_s)
    assert robot.spin(lambda: 'scale' in robot.diagnosis()[1])
    return node, robot.diagnosis()[1]


def captions(robot):
    return [marker.text for msg in robot.received['markers'] for marker in msg.markers
            if marker.text]


@pytest.mark.parametrize('scene, values, reason', [
    (ATTIC, {'scale__method': 'none'}, 'requested by scale.method'),
    (ROOM, {}, 'manhattan, unit unknown'),
    (ROOM, {'scale__gravity': [0.0, -1.0, 0.0], 'scale__camera_height': 0.01,
            'scale__method': 'camera_height'}, 'no plane can be the floor')])
def test_no_metres_are_claimed_where_nothing_fixes_the_scale(robot, drawn, scene, values,
                                                              reason):
    _, diagnosis = run(robot, scene, **values)
    assert diagnosis['scale'] == 'relative'
    assert reason in diagnosis['scale_note']
    statuses = [status for msg in robot.received['diagnostics'] for status in msg.status]
    assert any(status.name.endswith(': planes') for status in statuses)
    said = [f'{value.key}: {value.value}' for status in statuses for value in status.values]
    said += [status.message for status in statuses]
    for text in (*said, *robot.log().splitlines(), *captions(robot), *drawn):
        assert claims(text) == [], text
    assert captions(robot) and drawn, 'there is something to read'
    assert not robot.received['points_without_floor'], 'obstacles need metres'


def test_the_same_network_claims_metres_while_its_scale_is_given(robot):
    """Set at run time: from the next frame on there are none."""
    node, diagnosis = run(robot, ROOM, scale__method='fixed', scale__disparity_scale=1 / 3,
                          scale__disparity_shift=0.2 / 3)
    assert diagnosis['scale'] == 'fixed'
    assert captions(robot) and all(claims(text) for text in captions(robot))
    node.set_parameters([Parameter('scale.method', value='none')])
    robot.received['markers'].clear()
    send(robot, ROOM, 9)
    robot.wait_for('markers')
    assert robot.spin(lambda: robot.diagnosis()[1]['scale'] == 'relative')
    assert not any(claims(text) for text in captions(robot))
    assert robot.is_logged('scale: relative')
