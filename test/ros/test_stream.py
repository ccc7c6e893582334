# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A Python user of PlaneDetector gets what the node publishes, over resets and bad frames too."""

import numpy as np
import pytest
from node_helpers import small_room, start
from ros_helpers import camera_info_msg, cloud_array, image_array, image_msg

pytest.importorskip('rclpy')

from std_srvs.srv import Trigger

from plane_detector.config import Config, NodeConfig
from plane_detector.depth.observation import DepthFunction
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.pipeline import PlaneDetector
from plane_detector.ros.frame_processor import measured_gravity
from plane_detector.ros.inputs.synchronizer import Frame
from plane_detector.ros.inputs.transforms import CameraPose
from plane_detector.ros.outputs.clouds import planes_to_msg
from plane_detector.ros.outputs.frame import DetectedFrame

ROOM = small_room()
LARGEST = np.bincount(ROOM.labels[ROOM.labels >= 0]).argmax()
WHOLE, WITHOUT, BAD = range(3)
DEPTHS_M = (ROOM.depth_m, np.where(ROOM.labels == LARGEST, np.nan, ROOM.depth_m),
            ROOM.depth_m[:-1])
RESET = 'reset'
# The image, and its time in seconds; before the first frame after a reset, and after the jump
# back, one is bad.
STREAM = [(WHOLE, 10.0), (WITHOUT, 10.07), (WITHOUT, 10.3), (BAD, 10.4), (WHOLE, 10.45), RESET,
          (BAD, 10.5), (WITHOUT, 10.6), (WHOLE, 10.67), (BAD, 5.0), (WITHOUT, 5.1), (WHOLE, 5.17)]
STARTS_ANEW = 10.6, 5.1


def rgb_of(kind):
    rgb = ROOM.rgb.copy()
    rgb[0, 0, 0] = kind
    return rgb


def network():
    """Return a depth function that finds the kind of the image in its first pixel."""
    return DepthFunction(lambda rgb: DEPTHS_M[rgb[0, 0, 0]].astype(np.float32), noise_share=0.01)


def by_core():
    """Return the detections of the good images by their times."""
    detector, found = PlaneDetector(Config(), network()), {}
    for step in STREAM:
        if step == RESET:
            detector.reset()
        elif step[0] == BAD:
            with pytest.raises(ValueError, match='size'):
                detector.detect(rgb_of(BAD), ROOM.intrinsics, stamp_s=step[1])
        else:
            found[step[1]] = detector.detect(rgb_of(step[0]), ROOM.intrinsics, stamp_s=step[1])
    return found


def by_node(robot):
    """Return the labels and the planes that the node publishes, by the times of the images."""
    start(robot, network())
    good, bad, found = 0, 0, {}
    for step in STREAM:
        if step == RESET:
            assert robot.call(Trigger, 'plane_detector/reset_tracking').success
            continue
        kind, stamp_s = step
        robot.publish('camera_info', camera_info_msg(ROOM.intrinsics, stamp_s))
        robot.publish('image', image_msg(rgb_of(kind), 'rgb8', stamp_s))
        if kind == BAD:
            bad += 1
            assert robot.spin(lambda count=bad: robot.diagnosis()[1]['frames_skipped'] == str(
                count))
            continue
        good += 1
        found[stamp_s] = tuple(robot.wait_for(name, good)[-1] for name in ('labels', 'planes'))
    return found


def test_the_node_publishes_what_the_detector_finds(robot):
    expected, found = by_core(), by_node(robot)
    assert found.keys() == expected.keys()
    for stamp_s, (labels, planes) in found.items():
        frame = DetectedFrame(expected[stamp_s], ROOM.intrinsics, header=planes.header,
                              rgb=ROOM.rgb, settings=NodeConfig())
        np.testing.assert_array_equal(image_array(labels, '<u2')[..., 0], frame.labels)
        np.testing.assert_array_equal(cloud_array(planes), cloud_array(planes_to_msg(frame)))
    for stamp_s, detection in expected.items():
        labels = detection.planes.labels.tolist()
        is_new = labels == list(range(1, len(labels) + 1))
        assert is_new == (stamp_s in (10.0, 10.45, *STARTS_ANEW)), stamp_s


def camera_pose(gravity):
    """Return the pose of a camera a metre above the base, with this direction of gravity."""
    side = np.roll(np.abs(gravity), 1)
    return CameraPose(RigidTransform(
        np.stack([np.cross(side, -gravity), side, -gravity]), np.array([0.0, 0.0, 1.0])))


@pytest.mark.parametrize('imu, pose, expected', [
    ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), ((0.0, 1.0, 0.0), 'imu')),
    (None, (0.0, 0.0, 1.0), ((0.0, 0.0, 1.0), 'tf')),
    ((0.0, 1.0, 0.0), None, ((0.0, 1.0, 0.0), 'imu'))])
def test_the_imu_comes_before_tf_which_cannot_see_a_slope(imu, pose, expected):
    frame = Frame(None, None, None, None if imu is None else np.array(imu), 0)
    direction, source = measured_gravity(frame, pose and camera_pose(np.array(pose)))
    assert (tuple(direction), source) == expected
    detector = PlaneDetector(Config(), network())
    found = detector.find_directions(
        detector.estimate_depth(rgb_of(WHOLE), ROOM.intrinsics), direction, source).gravity
    assert (tuple(found.gravity_camera), found.source) == expected


def test_without_a_sensor_there_is_no_measured_direction():
    assert measured_gravity(Frame(None, None, None, None, 0), None)[0] is None
