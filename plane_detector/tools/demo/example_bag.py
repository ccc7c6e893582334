# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A small bag with the topics of a depth camera, on which the tutorial can be followed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from plane_detector.ros.calibration import camera_info_to_msg
from plane_detector.ros.outputs.messages import rgb_to_msg
from plane_detector.tools.demo.photographs import Photograph
from plane_detector.tools.replay.writer import BagWriter, Draft

IMAGES, PERIOD_NS, START_NS = 6, 200_000_000, 1_000_000_000
COLOUR = '/camera/camera/color'
DEPTH = '/camera/camera/aligned_depth_to_color/image_raw'


def write_example_bag(target: Path, photograph: Photograph) -> None:
    """
    Write images, CameraInfo and depth of a camera that does not move, as a RealSense sends them.

    The folder must not exist.
    """
    depth_mm = np.rint(1000 * np.nan_to_num(photograph.true_depth_m)).astype('<u2')
    height, width = depth_mm.shape
    with Draft(target) as draft:
        with BagWriter(draft.path, 'mcap', compressed=True) as bag:
            bag.add_outputs({f'{COLOUR}/image_raw': Image, f'{COLOUR}/camera_info': CameraInfo,
                             DEPTH: Image})
            for time_ns in range(START_NS, START_NS + IMAGES * PERIOD_NS, PERIOD_NS):
                header = Header(stamp=Time(nanoseconds=time_ns).to_msg(),
                                frame_id='camera_color_optical_frame')
                for topic, msg in (
                        (f'{COLOUR}/camera_info',
                         camera_info_to_msg(header, photograph.intrinsics)),
                        (DEPTH, Image(header=header, height=height, width=width, step=2 * width,
                                      encoding='16UC1', data=depth_mm.tobytes())),
                        (f'{COLOUR}/image_raw', rgb_to_msg(header, photograph.rgb))):
                    bag.write(topic, time_ns, msg)
        draft.publish()
