# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The camera that a CameraInfo describes."""

import pytest
from ros_helpers import camera_info_msg

from plane_detector.ros.calibration import intrinsics_from_msg
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(500.0, 510.0, 319.5, 239.5, 640, 480)


def test_intrinsics_of_a_raw_image_are_k():
    info = camera_info_msg(CAMERA)
    info.p[0] = 400.0
    assert intrinsics_from_msg(info) == CAMERA


def test_intrinsics_of_a_rectified_image_are_p_or_k_where_it_is_empty():
    info = camera_info_msg(CAMERA)
    info.p = [400.0, 0, 310, 0, 0, 401, 230, 0, 0, 0, 1, 0]
    rectified = intrinsics_from_msg(info, rectified=True)
    assert rectified == CameraIntrinsics(400.0, 401.0, 310.0, 230.0, 640, 480)
    info.p = [0.0] * 12
    assert intrinsics_from_msg(info, rectified=True) == CAMERA


def test_region_of_interest_and_binning():
    info = camera_info_msg(CAMERA)
    info.roi.x_offset, info.roi.y_offset, info.roi.width, info.roi.height = 100, 40, 400, 300
    info.binning_x, info.binning_y = 2, 3
    sent = intrinsics_from_msg(info)
    assert sent == CameraIntrinsics(250.0, 170.0, (319.5 - 100) / 2, (239.5 - 40) / 3, 200, 100)


def test_an_uncalibrated_camera_is_refused():
    info = camera_info_msg(CAMERA)
    info.k = [0.0] * 9
    with pytest.raises(ValueError, match='not calibrated'):
        intrinsics_from_msg(info)


@pytest.mark.parametrize('fx', [400.0, 120.5, 3000.0])
def test_a_rectified_image_needs_no_k(fx):
    info = camera_info_msg(CAMERA)
    info.k, info.p = [0.0] * 9, [fx, 0, 310, 0, 0, 401, 230, 0, 0, 0, 1, 0]
    assert intrinsics_from_msg(info, rectified=True) == CameraIntrinsics(
        fx, 401.0, 310.0, 230.0, 640, 480)
    with pytest.raises(ValueError,
                       match=f'K of the CameraInfo is zero.* its P has fx {fx:g} px.* image_rect'):
        intrinsics_from_msg(info)
    info.p = [0.0] * 12
    with pytest.raises(ValueError, match='not calibrated; .* load the calibration$'):
        intrinsics_from_msg(info, rectified=True)
