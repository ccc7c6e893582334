# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The node on a robot with a tree of frames: gravity from TF, outputs in another frame."""

import numpy as np
from node_helpers import send, small_room, start
from ros_helpers import FRAME_ID, cloud_array, header, transform_msg
from scipy.spatial.transform import Rotation

from plane_detector.planes.classification import PlaneClass
from plane_detector.ros.inputs.transforms import FrameTransforms, TransformBuffer

ROOM = small_room()


def standing_transforms(frame='base_footprint', stamp_s=0.0, is_static=True):
    """Return TF of a robot that stands on the floor of the room, with z up."""
    up = -ROOM.gravity_camera
    x_axis = np.cross(up, [1.0, 0.0, 0.0])
    x_axis /= np.linalg.norm(x_axis)
    to_base = np.stack([x_axis, np.cross(up, x_axis), up])
    buffer = TransformBuffer()
    buffer.add(transform_msg(frame, FRAME_ID, (0.4, 0.3, ROOM.height_m),
                             Rotation.from_matrix(to_base).as_quat(), stamp_s), is_static)
    return FrameTransforms(buffer)


def test_the_height_of_the_camera_from_tf_makes_a_relative_network_metric(robot):
    def estimate(rgb):
        return (0.4 / ROOM.depth_m).astype(np.float32)

    start(robot, estimate, transforms=standing_transforms(), base_frame='base_footprint',
          depth__output='relative_disparity')
    send(robot, ROOM)
    table = cloud_array(robot.wait_for('planes')[0])[0]
    (floor,) = table[table['class'] == PlaneClass.FLOOR]
    assert abs(floor['d'] - ROOM.height_m) < 0.02
    assert robot.spin(lambda: robot.diagnosis()[1].get('scale') in (
        'camera_height', 'manhattan'))


def test_outputs_in_the_target_frame(robot):
    start(robot, lambda rgb: ROOM.depth_m, transforms=standing_transforms(),
          base_frame='base_footprint', target_frame='base_footprint')
    send(robot, ROOM, 2.5)
    for name in ('points', 'planes', 'plane_poses', 'points_without_floor'):
        received = robot.wait_for(name)[0].header
        assert (received.frame_id, received.stamp) == ('base_footprint', header(2.5).stamp), name
    for name in ('depth', 'labels', 'overlay'):
        assert robot.wait_for(name)[0].header == header(2.5), name
    table = cloud_array(robot.received['planes'][0])[0]
    (floor,) = table[table['class'] == PlaneClass.FLOOR]
    assert floor['normal_z'] > 0.999
    assert abs(floor['z']) < 0.02
    assert abs(floor['d']) < 0.02
    cloud = cloud_array(robot.received['points'][0])
    on_floor = cloud['z'][cloud['label'] == floor['label']]
    assert np.abs(on_floor).max() < 0.1
    pose = robot.received['plane_poses'][0].poses[list(table['label']).index(floor['label'])]
    z_axis = Rotation.from_quat([pose.orientation.x, pose.orientation.y, pose.orientation.z,
                                 pose.orientation.w]).as_matrix()[:, 2]
    assert z_axis[2] > 0.999
    for marker in robot.wait_for('markers')[0].markers:
        assert marker.header.frame_id == 'base_footprint'
        if marker.ns == 'outline' and marker.id == floor['label']:
            turn = Rotation.from_quat([marker.pose.orientation.x, marker.pose.orientation.y,
                                       marker.pose.orientation.z, marker.pose.orientation.w])
            corners_m = turn.apply([[p.x, p.y, p.z] for p in marker.points])
            assert np.abs(corners_m[:, 2] + marker.pose.position.z).max() < 0.02


def test_a_frame_without_transform_is_skipped_and_logged(robot):
    start(robot, lambda rgb: ROOM.depth_m, transforms=standing_transforms(is_static=False),
          target_frame='map')
    send(robot, ROOM)
    assert robot.is_logged('no transform from camera_optical_frame to map')
    assert robot.is_logged('the frames are not connected'), 'the reason of TF itself'
    assert robot.spin(lambda: robot.diagnosis()[1]['frames_skipped'] == '1')
    assert not robot.received['planes']
