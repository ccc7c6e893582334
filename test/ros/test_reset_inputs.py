# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What the inputs of the node forget and refuse."""

import numpy as np
import pytest
from depth_messages import cloud_msg
from rclpy.time import Time
from ros_helpers import FRAME_ID, header, transform_msg

from plane_detector.config import NodeConfig
from plane_detector.geometry.projection import depth_to_points
from plane_detector.ros.inputs.depth_decoding import check_rays
from plane_detector.ros.inputs.transforms import FrameTransforms, TransformBuffer
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(60.0, 62.0, 39.5, 29.5, 80, 60)


class Tf2Buffer(TransformBuffer):
    """Like that of tf2: transforms older by ten seconds than the newest are ignored."""

    def __init__(self):
        super().__init__()
        self._newest_s = -np.inf

    def add(self, msg, is_static=False):
        stamp_s = 1e-9 * Time.from_msg(msg.header.stamp).nanoseconds
        if stamp_s > self._newest_s - 10:
            self._newest_s = max(self._newest_s, stamp_s)
            super().add(msg, is_static)

    def clear(self):
        self.__init__()


class Listener:
    def unregister(self):
        pass


def test_after_a_jump_back_in_time_the_transforms_of_the_new_time_count():
    buffer = Tf2Buffer()
    transforms = FrameTransforms(buffer, Listener())
    buffer.add(transform_msg('odom', FRAME_ID, (9.0, 0.0, 1.0), stamp_s=100.0))
    transforms.forget()
    for stamp_s in (1.0, 2.0):
        buffer.add(transform_msg('odom', FRAME_ID, (3.0, 0.0, 1.0), stamp_s=stamp_s))
    pose = transforms.to_target(header(1.5), NodeConfig(target_frame='odom'))
    assert pose.translation_m == pytest.approx([3.0, 0.0, 1.0])


@pytest.mark.parametrize('mirror', [(1, -1, 1), (-1, 1, 1)])
def test_a_cloud_that_is_mirrored_is_refused(mirror):
    """With y up, or with the columns from right to left."""
    points_m = depth_to_points(np.full((60, 80), 2.0, np.float32), CAMERA)
    check_rays(cloud_msg(points_m), CAMERA)
    with pytest.raises(ValueError, match='not on the rays of their pixels'):
        check_rays(cloud_msg(points_m * mirror), CAMERA)
