# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Assembly of frames from messages."""

import sys

import numpy as np
import pytest
from ros_helpers import camera_info_msg, header, image_msg
from sensor_msgs.msg import Imu

from plane_detector.ros.inputs.synchronizer import FrameSynchronizer
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(50.0, 50.0, 3.5, 2.5, 8, 6)


def image(stamp_s):
    return image_msg(np.zeros((6, 8, 3), np.uint8), 'rgb8', stamp_s)


def depth(stamp_s):
    return image_msg(np.ones((6, 8), np.float32), '32FC1', stamp_s)


def info(stamp_s):
    return camera_info_msg(CAMERA, stamp_s)


def calibrated(**options):
    """Return a synchronizer that has a calibration."""
    synchronizer = FrameSynchronizer(**options)
    synchronizer.add_camera_info(info(0.0))
    return synchronizer


def test_the_first_image_waits_for_its_own_calibration():
    synchronizer = FrameSynchronizer()
    first = image(1.0)
    synchronizer.add_image(first)
    (frame,) = synchronizer.add_camera_info(info(1.0))
    assert frame.image is first
    assert synchronizer.take_dropped() == 0


def test_calibration_of_the_same_stamp_comes_before_the_latest():
    synchronizer = FrameSynchronizer()
    own, latest = info(1.0), info(2.0)
    synchronizer.add_camera_info(own)
    synchronizer.add_camera_info(latest)
    assert synchronizer.add_image(image(1.0))[0].camera_info is own
    assert synchronizer.add_image(image(1.5))[0].camera_info is latest


LARGE = CameraIntrinsics(100.0, 100.0, 7.5, 5.5, 16, 12)


def large_image(stamp_s):
    return image_msg(np.zeros((12, 16, 3), np.uint8), 'rgb8', stamp_s)


@pytest.mark.parametrize('depth_use', ['unused', 'optional'])
@pytest.mark.parametrize('stamp_s', [1.1, 1.12])
def test_an_image_of_another_size_waits_for_its_calibration(depth_use, stamp_s):
    synchronizer = FrameSynchronizer(depth_use)
    synchronizer.add_camera_info(info(1.0))
    assert len(synchronizer.add_image(image(1.0))) == 1
    large, own = large_image(1.1), camera_info_msg(LARGE, stamp_s)
    assert synchronizer.add_image(large) == []
    assert synchronizer.add_camera_info(info(1.05)) == [], 'a late one of the old size'
    (frame,) = synchronizer.add_camera_info(own)
    assert (frame.image, frame.camera_info) == (large, own)
    assert synchronizer.take_dropped() == 0


def test_an_image_of_another_size_does_not_wait_for_a_calibration_before_the_latest():
    synchronizer = calibrated()
    large = large_image(0.1)
    assert synchronizer.add_image(large) == []
    (frame,) = synchronizer.add_camera_info(info(0.2))
    assert frame.image is large


def test_images_before_the_first_calibration_are_counted():
    synchronizer = FrameSynchronizer('required')
    for stamp_s in (0.9, 1.0):
        synchronizer.add_image(image(stamp_s))
    synchronizer.add_camera_info(info(1.0))
    assert len(synchronizer.add_depth(depth(1.0))) == 1
    assert synchronizer.take_dropped() == 1


def test_depth_images_of_earlier_frames_are_not_kept():
    """At most those of the last frame and of the one before, whose image may come again later."""
    synchronizer = calibrated(depth='required')
    first = depth(1.0)
    references = sys.getrefcount(first)
    synchronizer.add_depth(first)
    for stamp_s in (1.0, 1.1, 1.2):
        synchronizer.add_depth(depth(stamp_s + 0.1))
        assert len(synchronizer.add_image(image(stamp_s))) == 1
    assert sys.getrefcount(first) == references


def test_images_that_change_places_have_their_depth():
    synchronizer = calibrated(depth='required')
    depths = {stamp_s: depth(stamp_s) for stamp_s in (1.0, 1.1, 1.2, 1.3)}
    for message in depths.values():
        synchronizer.add_depth(message)
    for stamp_s in (1.0, 1.2, 1.1, 1.3):
        (frame,) = synchronizer.add_image(image(stamp_s))
        assert frame.depth is depths[stamp_s]


def test_depth_of_the_same_stamp_is_taken_whichever_comes_first():
    synchronizer = calibrated(depth='required')
    first, second = depth(1.0), depth(2.0)
    assert synchronizer.add_image(image(1.0)) == []
    assert synchronizer.add_depth(first)[0].depth is first
    assert synchronizer.add_depth(second) == []
    assert synchronizer.add_image(image(2.0))[0].depth is second


def test_an_exact_match_comes_before_a_near_one():
    synchronizer = calibrated(depth='required', stamp_slop_s=0.05)
    synchronizer.add_depth(depth(0.98))
    assert synchronizer.add_image(image(1.0)) == []
    own = depth(1.0)
    assert synchronizer.add_depth(own)[0].depth is own


def test_the_nearest_depth_within_the_slop_is_used_if_none_matches():
    synchronizer = calibrated(depth='required', stamp_slop_s=0.05)
    near = depth(0.98)
    synchronizer.add_depth(near)
    synchronizer.add_image(image(1.0))
    (frame,) = synchronizer.add_depth(depth(1.03))
    assert frame.depth is near


def test_the_number_of_images_waiting_for_depth_is_limited():
    synchronizer = calibrated(depth='required')
    for index in range(100):
        synchronizer.add_image(image(1 + index / 30))
    assert 80 <= synchronizer.take_dropped() < 100


def test_a_jump_back_in_time_starts_an_epoch_and_clears_the_buffers():
    synchronizer = FrameSynchronizer(depth='required', stamp_slop_s=0.05)
    synchronizer.add_camera_info(info(100.0))
    synchronizer.add_depth(depth(100.0))
    assert synchronizer.add_image(image(100.0))[0].epoch == 0
    assert synchronizer.add_image(image(5.0)) == []
    (frame,) = synchronizer.add_depth(depth(5.0))
    assert frame.epoch == 1
    (frame,) = synchronizer.add_image(image(4.99))
    assert frame.epoch == 1, 'an image that is only out of order is no jump'


def test_optional_depth_is_taken_where_there_is_some():
    synchronizer = calibrated(depth='optional')
    assert synchronizer.add_image(image(1.0))[0].depth is None, 'no depth at all: no waiting'
    own = depth(2.0)
    synchronizer.add_depth(own)
    assert synchronizer.add_image(image(2.0))[0].depth is own
    assert synchronizer.add_image(image(2.1)) == [], 'it may still come'
    (frame,) = synchronizer.add_image(image(2.2))
    assert (frame.image.header, frame.depth) == (image(2.1).header, None)
    late = depth(2.2)
    assert synchronizer.add_depth(late)[0].depth is late
    assert synchronizer.add_image(image(9.0))[0].depth is None, 'the depth topic has gone silent'
    assert synchronizer.take_dropped() == 0


def imu(stamp_s, force):
    msg = Imu(header=header(stamp_s))
    msg.linear_acceleration.x, msg.linear_acceleration.y, msg.linear_acceleration.z = force
    return msg


def test_gravity_of_the_imu_goes_with_the_frames():
    turned = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))  # x of the IMU is y of the camera
    synchronizer = calibrated(imu_to_camera=turned)
    assert synchronizer.add_image(image(1.0))[0].gravity_camera is None
    synchronizer.add_imu(imu(1.0, (-9.81, 0.0, 0.0)))
    np.testing.assert_allclose(synchronizer.add_image(image(1.01))[0].gravity_camera, [0, 1, 0],
                               atol=1e-9)
    synchronizer.add_imu(imu(1.1, (0.0, 0.0, 30.0)))
    np.testing.assert_allclose(synchronizer.add_image(image(1.11))[0].gravity_camera, [0, 1, 0],
                               atol=1e-9, err_msg='a jolt is not gravity')
    assert synchronizer.add_image(image(5.0))[0].gravity_camera is None, 'the IMU has gone silent'
    synchronizer.add_imu(imu(5.1, (-9.81, 0.0, 0.0)))
    assert synchronizer.add_image(image(5.1))[0].gravity_camera is not None
    assert synchronizer.add_image(image(1.0))[0].gravity_camera is None, 'time jumped back'
