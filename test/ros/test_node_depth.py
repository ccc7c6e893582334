# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Measured depth in every form through the node, with a colour image and without one."""

import numpy as np
import pytest
from depth_messages import cloud_msg, compressed_depth_msg
from node_helpers import CAMERA, assert_true_to, start
from ros_helpers import camera_info_msg, header, image_array, image_msg

from plane_detector.geometry.projection import depth_to_points


def counts(depth_m, unit_m):
    return np.nan_to_num(depth_m / unit_m).round().astype(np.uint16)


# Parameters, topic, and the message of a depth image.
FORMS = {
    'metres': ({}, 'depth', lambda depth_m: image_msg(depth_m, '32FC1', 2.0)),
    'tenths of a millimetre': ({'depth__unit': 0.0001}, 'depth', lambda depth_m: image_msg(
        counts(depth_m, 0.0001), '16UC1', 2.0)),
    'rvl': ({'depth__transport': 'compressedDepth'}, 'depth/compressedDepth',
            lambda depth_m: compressed_depth_msg(depth_m, kind='rvl', stamp_s=2.0)),
    'points': ({'depth__source': 'points'}, 'depth/points',
               lambda depth_m: cloud_msg(depth_to_points(depth_m, CAMERA), 2.0))}


@pytest.mark.parametrize('form, colour', [
    ('metres', 'image'), ('tenths of a millimetre', 'none'), ('rvl', 'none'), ('points', 'image'),
    ('points', 'none')])
def test_planes_of_every_form_are_true(robot, room, form, colour):
    parameters, topic, make = FORMS[form]
    # tenths of a millimetre reach to 6.5 m
    depth_m = np.where(room.depth_m < 6.5, room.depth_m, np.nan)
    start(robot, **{'depth__source': 'topic', **parameters}, depth__colour=colour)
    info_topic = 'depth/camera_info' if (form, colour) == ('points', 'none') else 'camera_info'
    robot.publish(info_topic, camera_info_msg(CAMERA, 2.0))
    if colour == 'image':
        robot.publish('image', image_msg(room.rgb, 'rgb8', 2.0))
    robot.publish(topic, make(depth_m))
    planes = robot.wait_for('planes')[0]
    assert planes.header == header(2.0)
    labels = image_array(robot.wait_for('labels')[0], '<u2')[..., 0]
    assert_true_to(room, planes, labels)


def test_without_colour_everything_but_colour_is_as_with_it(robot, room):
    """Also with gravity; obstacles and ground need no image."""
    start(robot, depth__source='topic', depth__colour='none',
          scale__gravity=room.gravity_camera.tolist())
    robot.publish('camera_info', camera_info_msg(CAMERA, 2.0))
    robot.publish('depth', image_msg(room.depth_m, '32FC1', 2.0))
    for name in ('points', 'points_without_floor', 'overlay', 'markers', 'plane_poses', 'depth'):
        assert robot.wait_for(name)[0], name
    overlay = image_array(robot.received['overlay'][0], 'u1', 3)
    assert len(np.unique(overlay.reshape(-1, 3), axis=0)) > 3, 'planes on grey'
    assert robot.diagnosis()[0].message == 'active'
