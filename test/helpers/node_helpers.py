# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A node in process, a camera that feeds it, and the truth, for the tests of the node."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.parameter import Parameter
from ros_helpers import camera_info_msg, cloud_array, image_msg

from plane_detector.evaluation.scenes.rooms import random_room
from plane_detector.ros.detector_node import PlaneDetectorNode
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(262.5, 262.5, 159.5, 119.5, 320, 240)


@lru_cache(maxsize=1)
def small_room():
    """Return a furnished room that the camera sees."""
    return random_room(np.random.default_rng(3), CAMERA)


def start(robot, depth_model=None, wait=True, transforms=None, **values):
    """Add a node with these parameters, and spin until it is active."""
    overrides = [Parameter(name.replace('__', '.'), value=value) for name, value in values.items()]
    node = PlaneDetectorNode(depth_model, transforms, context=robot.context,
                             parameter_overrides=overrides)
    robot.add(node)
    if wait:
        assert robot.spin(lambda: node.state == 'active'), robot.log()
    return node


def send(robot, scene, stamp_s=1.0, depth=False):
    robot.publish('camera_info', camera_info_msg(scene.intrinsics, stamp_s))
    if depth:
        robot.publish('depth', image_msg(scene.depth_m, '32FC1', stamp_s))
    robot.publish('image', image_msg(scene.rgb, 'rgb8', stamp_s))


def points_and_planes(robot):
    """Return points and planes of an image of which both have been received; None without any."""
    return next(((points, planes) for planes in robot.received['planes']
                 for points in robot.received['points'] if points.header == planes.header), None)


def assert_true_to(scene, planes, labels):
    """Check planes and labels against a rendered scene."""
    table = cloud_array(planes)[0]
    matched = 0
    for truth, plane in enumerate(scene.planes):
        mask = scene.labels == truth
        if mask.sum() < 0.03 * mask.size:
            continue
        label = np.bincount(labels[mask]).argmax()
        (row,) = table[table['label'] == label]
        normal = np.array([row['normal_x'], row['normal_y'], row['normal_z']], float)
        assert normal @ plane[:3] > np.cos(np.radians(1.0))
        assert abs(row['d'] - plane[3]) < 0.01
        assert (labels[mask] == label).mean() > 0.95
        matched += 1
    assert matched >= 3
    assert (table['d'] >= 0).all()
    assert np.isin(labels, np.append(table['label'], 0)).all()


def change_state(robot, transition):
    request = ChangeState.Request(transition=Transition(id=transition))
    return robot.call(ChangeState, 'plane_detector/change_state', request).success
