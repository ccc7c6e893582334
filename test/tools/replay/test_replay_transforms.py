# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Transforms that a bag brings: gravity, height of the camera, the frame of the outputs."""

import shutil

import numpy as np
import pytest
from bags import messages_of, read_bag, write_bag
from replay_helpers import camera_messages, planes_of, stamp_s, tf_message, time_ns
from ros_helpers import FRAME_ID, cloud_array, header
from sensor_msgs.msg import Imu, PointCloud2

from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.planes.classification import PlaneClass

HEIGHT_M = 1.4


def of_camera(gravity_camera):
    """Return where a camera is that is turned about its x axis only, HEIGHT_M above base_link."""
    angle = -(np.pi / 2 + np.arctan2(gravity_camera[2], gravity_camera[1])) / 2
    return tf_message('base_link', FRAME_ID, (0, 0, HEIGHT_M),
                      (np.sin(angle), 0, 0, np.cos(angle)), time_ns(0))


def write_bag_with_tf(tmp_path, scenes, broken=(), moving=()):
    """Write a bag whose first scene is seen from a camera that /tf_static places."""
    floor = max(range(len(scenes[0].planes)), key=lambda k: -scenes[0].planes[k, 1])
    static = [of_camera(-scenes[0].planes[floor, :3]), *broken]
    return write_bag(tmp_path / 'walk', [
        *(('/tf_static', time_ns(0), msg) for msg in static),
        *(('/tf', time_ns(0), msg) for msg in moving), *camera_messages(scenes)])


@pytest.fixture
def bag_with_tf(tmp_path, scenes):
    return write_bag_with_tf(tmp_path, scenes[:1])


def test_base_frame_gives_the_floor(bag_with_tf, replay):
    code, target, text = replay(bag_with_tf, '-p', 'base_frame:=base_link')
    assert code == 0, text
    table = cloud_array(planes_of(target)[0])[0]
    (floor,) = table[table['class'] == PlaneClass.FLOOR]
    assert floor['d'] == pytest.approx(HEIGHT_M, abs=0.02)
    assert '/plane_detector/points_without_floor' not in read_bag(target)
    shutil.rmtree(target)
    replay(bag_with_tf, '-p', 'base_frame:=base_link', '--outputs', 'points_without_floor')
    assert len(messages_of(target, '/plane_detector/points_without_floor', PointCloud2)) == 1


def test_broken_transforms_are_skipped_and_counted(tmp_path, scenes, replay):
    """Of the camera, not of a gripper that nobody needs: neither ends the replay."""
    broken = [b'\0\1\0\0\7']
    for frame in (FRAME_ID, 'gripper'):
        for name, value in (('w', 0.0), ('x', np.nan)):
            msg = tf_message('base_link', frame, np.zeros(3), np.zeros(4), time_ns(0))
            setattr(msg.transforms[0].transform.rotation, name, value)
            broken.append(msg)
    code, target, text = replay(write_bag_with_tf(tmp_path, scenes[:1], broken), '-p',
                                'base_frame:=base_link')
    assert code == 3, text
    assert '3 damaged messages were skipped' in text
    assert PlaneClass.FLOOR in cloud_array(planes_of(target)[0])[0]['class']


def test_target_frame_is_that_of_the_outputs(bag_with_tf, replay):
    code, target, text = replay(bag_with_tf, '-p', 'target_frame:=base_link', '-p',
                                'base_frame:=base_link')
    assert code == 0, text
    (planes,) = planes_of(target)
    assert planes.header.frame_id == 'base_link'
    table = cloud_array(planes)[0]
    (floor,) = table[table['class'] == PlaneClass.FLOOR]
    assert floor['normal_z'] == pytest.approx(1, abs=0.01)
    assert floor['z'] == pytest.approx(0, abs=0.03)


def test_an_ancestor_without_data_is_no_obstacle(tmp_path, scenes, replay):
    """The base is known in odom up to the third frame only; the camera is fixed to the base."""
    moving = [tf_message('odom', 'base_link', np.zeros(3), (0, 0, 0, 1),
                         round(stamp_s(index) * 1e9)) for index in (0, 2)]
    source = write_bag_with_tf(tmp_path, scenes, moving=moving)
    code, target, text = replay(source, '-p', 'base_frame:=base_link')
    assert code == 0, text
    assert len(planes_of(target)) == len(scenes)
    shutil.rmtree(target)
    code, target, text = replay(source, '-p', 'target_frame:=odom')
    assert code == 3
    assert f'1 frames skipped: no transform from {FRAME_ID} to odom' in text.splitlines()[-1]
    assert len(planes_of(target)) == len(scenes) - 1
    assert len(read_bag(target)['/plane_detector/labels']) == len(scenes), 'in their own frame'


def test_the_mounting_of_an_imu_comes_from_tf(tmp_path, scenes, replay):
    """An IMU of x forward, y left and z up, as most are, beside a camera of z forward."""
    floor = max(range(len(scenes[0].planes)), key=lambda k: -scenes[0].planes[k, 1])
    turn = RigidTransform.from_quaternion((0.5, -0.5, 0.5, 0.5), np.zeros(3))
    msg = tf_message(FRAME_ID, 'imu_link', np.zeros(3), turn.quaternion, time_ns(0))
    imu = Imu(header=header(stamp_s(0)))
    imu.header.frame_id = 'imu_link'
    force = imu.linear_acceleration
    force.x, force.y, force.z = (9.81 * turn.rotation.T @ scenes[0].planes[floor, :3]).tolist()
    bag = write_bag(tmp_path / 'walk', [
        ('/tf_static', time_ns(0), msg), ('/imu', time_ns(0), imu), *camera_messages(scenes[:1])])
    code, target, text = replay(bag, '-p', 'use_imu:=true')
    assert code == 0, text
    table = cloud_array(planes_of(target)[0])[0]
    assert PlaneClass.FLOOR in table['class']
    assert table[table['class'] == PlaneClass.FLOOR]['normal_y'] == pytest.approx(
        scenes[0].planes[floor, 1], abs=0.02)
