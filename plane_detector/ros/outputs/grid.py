# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The grid of free and occupied cells around the robot."""

from __future__ import annotations

from array import array

import numpy as np
from geometry_msgs.msg import Pose
from nav_msgs.msg import MapMetaData, OccupancyGrid
from std_msgs.msg import Header

from plane_detector.geometry.rigid_transform import RigidTransform, quaternions
from plane_detector.ground.grid import level_frame, occupancy_grid
from plane_detector.ros.outputs.frame import DetectedFrame
from plane_detector.ros.outputs.messages import pose_msgs


def grid_to_msg(frame: DetectedFrame) -> OccupancyGrid | None:
    """
    Return the grid in base_frame, or in the level frame under the camera, which its origin states.

    None while drops cannot be detected: what seems free might end at one.
    """
    found, ground = frame.detection, frame.detection.ground_result
    if not ground.is_known or ground.drop_note:
        return None
    header, to_grid, origin = frame.header, frame.to_base, RigidTransform.identity()
    if to_grid is None:
        to_grid = level_frame(found.gravity.gravity_camera, found.camera_height_m)
        origin = to_grid.inverse()
    else:
        header = Header(stamp=header.stamp, frame_id=frame.settings.base_frame)
    cells = occupancy_grid(found, frame.intrinsics, to_grid, frame.config.ground,
                           frame.config.grid)
    rows, columns = cells.shape
    half_m = frame.config.grid.resolution * rows / 2
    return OccupancyGrid(
        header=header, data=array('b', cells.tobytes()),
        info=MapMetaData(map_load_time=header.stamp, resolution=frame.config.grid.resolution,
                         width=columns, height=rows, origin=_pose(origin, half_m)))


def _pose(origin: RigidTransform, half_m: float) -> Pose:
    """Return the pose of the corner of a grid around a frame."""
    (pose,) = pose_msgs(origin.points(np.array([[-half_m, -half_m, 0.0]])),
                        quaternions(origin.rotation[None]))
    return pose
