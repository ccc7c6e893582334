# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Measured depth in every form through the node, with a colour image and without one."""

import cv2
import numpy as np
import pytest
from depth_messages import cloud_msg, compressed_depth_msg
from node_helpers import CAMERA, assert_true_to, start
from ros_helpers import camera_info_msg, header, image_array, image_msg

from plane_detector.geometry.projection import depth_to_points

COMPRESSED = {'depth__transport': 'compressedDepth'}


def counts(depth_m, unit_m):
    return np.nan_to_num(depth_m / unit_m).round().astype(np.uint16)


# Parameters, topic, and the message of a depth image.
FORMS = {
    'metres': ({}, 'depth', lambda depth_m: image_msg(depth_m, '32FC1', 2.0)),
    'tenths of a millimetre': ({'depth__unit': 0.0001}, 'depth', lambda depth_m: image_msg(
        counts(depth_m, 0.0001), '16UC1', 2.0)),
    'png': (COMPRESSED, 'depth/compressedDepth',
            lambda depth_m: compressed_depth_msg(depth_m, '32FC1', stamp_s=2.0)),
    'rvl': (COMPRESSED, 'depth/compressedDepth',
            lambda depth_m: compressed_depth_msg(depth_m, kind='rvl', stamp_s=2.0)),
    'points': ({'depth__source': 'points'}, 'depth/points',
               lambda depth_m: cloud_msg(depth_to_points(depth_m, CAMERA), 2.0))}


@pytest.mark.parametrize('form, colour', [
    ('metres', 'image'), ('tenths of a millimetre', 'none'), ('png', 'image'), ('rvl', 'none'),
    ('points', 'image'), ('points', 'none')])
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


def test_a_distorted_depth_camera_is_rectified(robot, room):
    """Its image is made by distorting the rendered one; the planes are as flat and as far."""
    distortion = np.array([-0.2, 0.05, 0.0, 0.0, 0.0])
    matrix = np.array([[CAMERA.fx, 0, CAMERA.cx], [0, CAMERA.fy, CAMERA.cy], [0, 0, 1]])
    columns, rows = np.meshgrid(np.arange(320, dtype=np.float64), np.arange(240))
    straight = cv2.undistortPoints(np.stack([columns, rows], -1).reshape(-1, 1, 2), matrix,
                                   distortion, P=matrix).reshape(240, 320, 2).astype(np.float32)
    seen_m = cv2.remap(room.depth_m, straight[..., 0], straight[..., 1], cv2.INTER_NEAREST,
                       borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan)
    start(robot, depth__source='topic', depth__colour='none')
    info = camera_info_msg(CAMERA, 2.0)
    info.d = distortion.tolist()
    robot.publish('camera_info', info)
    robot.publish('depth', image_msg(seen_m, '32FC1', 2.0))
    found_m = image_array(robot.wait_for('depth')[0], '<f4')[..., 0]
    inner = np.s_[60:180, 80:240]
    assert np.nanmedian(abs(found_m - room.depth_m)[inner]) < 0.01


def test_depth_without_colour_needs_a_sensor(robot):
    with pytest.raises(ValueError, match='colour can be none only with depth.source topic'):
        start(robot, depth__colour='none')


def test_the_other_transport_of_depth_is_proposed(robot, room):
    start(robot, depth__source='topic', depth__colour='none')
    robot.node.create_publisher(type(compressed_depth_msg(room.depth_m)),
                                '/cam/depth/image/compressedDepth', 1)
    assert robot.is_logged('/cam/depth/image/compressedDepth is a sensor_msgs/msg/CompressedImage'
                           ': set depth.transport to compressedDepth')
