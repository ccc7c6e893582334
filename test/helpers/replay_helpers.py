# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A walk through a room as it is recorded, and the truth of it, for the tests of the replay."""

import csv

import numpy as np
import pytest
from bags import messages_of
from ros_helpers import FRAME_ID, camera_info_msg, cloud_array, image_msg
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import Image, PointCloud2

from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(130.0, 130.0, 79.5, 59.5, 160, 120)
START_S, PERIOD_S = 1700000000, 0.1
TYPES = get_typestore(Stores.ROS2_JAZZY).types
IMAGE, INFO, DEPTH = '/cam/image_raw', '/cam/camera_info', '/cam/depth'


def stamp_s(index):
    return START_S + PERIOD_S * index


def time_ns(index):
    """When an image was recorded: a little after its stamp."""
    return round(stamp_s(index) * 1e9) + 5_000_000


def camera_messages(scenes, depth=True, names=(IMAGE, INFO, DEPTH)):
    """Return images, calibrations and depth images as they are recorded."""
    messages = []
    for index, scene in enumerate(scenes):
        messages += [(names[0], time_ns(index), image_msg(scene.rgb, 'rgb8', stamp_s(index))),
                     (names[1], time_ns(index) + 1000, camera_info_msg(CAMERA, stamp_s(index)))]
        if depth:
            messages.append((names[2], time_ns(index) + 2000,
                             image_msg(scene.depth_m, '32FC1', stamp_s(index))))
    return messages


def tf_message(parent, child, translation_m, quaternion, stamp_ns):
    """Return a transform as it is recorded, quaternion x y z w."""
    make = {name: TYPES[f'geometry_msgs/msg/{name}'] for name in (
        'TransformStamped', 'Transform', 'Vector3', 'Quaternion')}
    return TYPES['tf2_msgs/msg/TFMessage']([make['TransformStamped'](
        header=TYPES['std_msgs/msg/Header'](TYPES['builtin_interfaces/msg/Time'](
            stamp_ns // 10**9, stamp_ns % 10**9), parent),
        child_frame_id=child, transform=make['Transform'](
            make['Vector3'](*map(float, translation_m)),
            make['Quaternion'](*map(float, quaternion))))])


def rows_of(table):
    """Return the rows of a CSV file by their columns."""
    with open(table, encoding='utf-8') as file:
        return list(csv.DictReader(file))


def planes_of(target):
    return messages_of(target, '/plane_detector/planes', PointCloud2)


def stamps_of(messages):
    return [round(msg.header.stamp.sec + 1e-9 * msg.header.stamp.nanosec - START_S, 3)
            for msg in messages]


def assert_true(target, scenes):
    """Check coefficients, labels, stamps and frame of every image."""
    planes = planes_of(target)
    labels = messages_of(target, '/plane_detector/labels', Image)
    assert stamps_of(planes) == [round(PERIOD_S * k, 3) for k in range(len(scenes))]
    for scene, msg, label_msg in zip(scenes, planes, labels, strict=True):
        assert msg.header == label_msg.header
        assert msg.header.frame_id == FRAME_ID
        table = cloud_array(msg)[0]
        pixels = np.frombuffer(label_msg.data, '<u2').reshape(scene.labels.shape)
        large = [k for k in range(len(scene.planes)) if (scene.labels == k).mean() > 0.03]
        assert len(large) >= 4
        for k in large:
            label = np.bincount(pixels[scene.labels == k]).argmax()
            (row,) = table[table['label'] == label]
            normal = np.array([row['normal_x'], row['normal_y'], row['normal_z']], float)
            assert normal @ scene.planes[k, :3] > np.cos(np.radians(1.0))
            assert row['d'] == pytest.approx(scene.planes[k, 3], abs=0.01)
