# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Pictures for people come at their rate: the first at once, the last one always."""

from types import SimpleNamespace

import pytest
from node_helpers import change_state, small_room, start
from ros_helpers import camera_info_msg, image_msg

pytest.importorskip('rclpy')

from lifecycle_msgs.msg import Transition
from sensor_msgs.msg import CompressedImage

from plane_detector.ros.outputs import pictures

ROOM = small_room()
PICTURES = ('markers', 'overlay', 'overlay/compressed')


@pytest.fixture
def clock(monkeypatch):
    """Return the clock of the pictures, which stands."""
    clock = SimpleNamespace(now_s=100.0)
    monkeypatch.setattr(pictures, 'time', SimpleNamespace(monotonic=lambda: clock.now_s))
    return clock


def show(robot, stamp_s, count):
    """Let the node see an image, until as many have passed it."""
    robot.publish('camera_info', camera_info_msg(ROOM.intrinsics, stamp_s))
    robot.publish('image', image_msg(ROOM.rgb, 'rgb8', stamp_s))
    robot.wait_for('planes', count)


def stamps_s(robot, name):
    stamped = (msg.markers[0] if name == 'markers' else msg for msg in robot.received[name])
    return [one.header.stamp.sec for one in stamped]


def test_pictures_come_at_their_rate_and_the_last_one_always(robot, clock):
    start(robot, lambda rgb: ROOM.depth_m)
    robot.listen(CompressedImage, 'plane_detector/overlay/compressed', 'overlay/compressed')
    show(robot, 1, 1)
    for name in PICTURES:
        robot.wait_for(name, 1)
    for k in (2, 3, 4):  # in the same tenth of a second
        show(robot, k, k)
    clock.now_s += 0.11
    show(robot, 5, 5)
    for name in PICTURES:
        robot.wait_for(name, 2)
        assert stamps_s(robot, name) == [1, 5]
    clock.now_s += 0.02
    show(robot, 6, 6)
    clock.now_s += 0.16  # no other image comes
    for name in PICTURES:
        robot.wait_for(name, 3)
        assert stamps_s(robot, name) == [1, 5, 6]
    assert stamps_s(robot, 'planes') == [1, 2, 3, 4, 5, 6]


def test_rate_0_makes_pictures_of_every_image(robot, clock):
    start(robot, lambda rgb: ROOM.depth_m, picture_rate=0.0)
    for k in (1, 2, 3):
        show(robot, k, k)
        robot.wait_for('markers', k)
    assert stamps_s(robot, 'markers') == [1, 2, 3]


def test_what_waits_is_not_shown_by_a_node_that_is_no_longer_active(robot, clock):
    start(robot, lambda rgb: ROOM.depth_m)
    show(robot, 1, 1)
    robot.wait_for('markers')
    show(robot, 2, 2)
    assert change_state(robot, Transition.TRANSITION_DEACTIVATE)
    clock.now_s += 10
    assert change_state(robot, Transition.TRANSITION_ACTIVATE)
    show(robot, 3, 3)
    robot.wait_for('markers', 2)
    assert stamps_s(robot, 'markers') == [1, 3]
