# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A small bag with the topics of a depth camera, for following the tutorial."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from geometry_msgs.msg import TransformStamped
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.ground.grid import level_frame
from plane_detector.ros.calibration import camera_info_to_msg
from plane_detector.ros.outputs.messages import rgb_to_msg
from plane_detector.tools.demo.photographs import WORKSHOP_GRAVITY, Photograph
from plane_detector.tools.replay.writer import AtomicOutput, BagWriter

IMAGES, PERIOD_NS, START_NS = 6, 200_000_000, 1_000_000_000
COLOUR = '/camera/camera/color'
DEPTH = '/camera/camera/aligned_depth_to_color/image_raw'
CAMERA_FRAME = 'camera_color_optical_frame'
HEIGHT_M = 1.07  # of the camera above the floor of the workshop, from its measured depth


def write_example_bag(target: Path, photograph: Photograph) -> None:
    """
    Write images, CameraInfo and depth of a camera that does not move, as a RealSense sends them,
    and its pose on a robot: odom, base_footprint, camera_color_optical_frame.

    The folder must not exist.
    """
    depth_mm = np.rint(1000 * np.nan_to_num(photograph.true_depth_m)).astype('<u2')
    height, width = depth_mm.shape
    with AtomicOutput(target) as draft:
        with BagWriter(draft.path, 'mcap', compressed=True) as bag:
            bag.add_outputs({f'{COLOUR}/image_raw': Image, f'{COLOUR}/camera_info': CameraInfo,
                             DEPTH: Image})
            bag.write_static_transforms(START_NS, [
                _transform('odom', 'base_footprint', RigidTransform.identity()),
                _transform('base_footprint', CAMERA_FRAME,
                           level_frame(np.array(WORKSHOP_GRAVITY), HEIGHT_M))])
            for time_ns in range(START_NS, START_NS + IMAGES * PERIOD_NS, PERIOD_NS):
                header = Header(stamp=Time(nanoseconds=time_ns).to_msg(),
                                frame_id=CAMERA_FRAME)
                for topic, msg in (
                        (f'{COLOUR}/camera_info',
                         camera_info_to_msg(header, photograph.intrinsics)),
                        (DEPTH, Image(header=header, height=height, width=width, step=2 * width,
                                      encoding='16UC1', data=depth_mm.tobytes())),
                        (f'{COLOUR}/image_raw', rgb_to_msg(header, photograph.rgb))):
                    bag.write(topic, time_ns, msg)
        draft.publish()


def _transform(parent: str, child: str, parent_from_child: RigidTransform) -> TransformStamped:
    msg = TransformStamped(header=Header(stamp=Time(nanoseconds=START_NS).to_msg(),
                                         frame_id=parent), child_frame_id=child)
    to, turn = msg.transform.translation, msg.transform.rotation
    to.x, to.y, to.z = parent_from_child.translation_m.tolist()
    turn.x, turn.y, turn.z, turn.w = parent_from_child.quaternion.tolist()
    return msg
