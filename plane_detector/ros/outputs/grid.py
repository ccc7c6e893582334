# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The grid of free and occupied cells around the robot."""

from __future__ import annotations

from array import array

import numpy as np
from nav_msgs.msg import MapMetaData, OccupancyGrid
from std_msgs.msg import Header

from plane_detector.geometry.rigid_transform import RigidTransform, quaternions
from plane_detector.ground.grid import level_frame, occupancy_grid
from plane_detector.ros.outputs.frame import DetectedFrame
from plane_detector.ros.outputs.messages import pose_msgs

# Cosine of the angle between up and the z axis of a target frame with level cells. Chosen: halfway
# between upright frames (odom, base_link, also on ramps) and lying frames (optical ones).
LEAST_UP = 0.7


def grid_to_msg(frame: DetectedFrame) -> OccupancyGrid | None:
    """
    Return the grid around the robot; None while drops cannot be detected, where free cells may
    end.

    It is in ``target_frame`` if the z axis of that frame points up; the cells then are along its
    axes, at the same places in each image. Otherwise it is in ``base_frame``, or in the level
    frame below the camera, which its origin states.
    """
    found, ground = frame.detection, frame.detection.ground_result
    resolution_m = frame.config.grid.resolution
    if not ground.is_known or ground.drop_note:
        return None
    header, to_grid, origin = frame.header, frame.to_base, RigidTransform.identity()
    if to_grid is None:
        to_grid = level_frame(found.gravity.gravity_camera, found.camera_height_m)
        origin = to_grid.inverse()
    else:
        header = Header(stamp=header.stamp, frame_id=frame.settings.base_frame)
    pose = frame.pose
    if pose is not None and -pose.rotation[2] @ found.gravity.gravity_camera > LEAST_UP:
        # Costmaps assume that a grid does not move with the robot.
        centre_m = pose.points(to_grid.inverse().translation_m)
        centre_m[:2] = np.round(centre_m[:2] / resolution_m) * resolution_m
        header, origin = frame.target_header, RigidTransform(np.eye(3), centre_m)
        to_grid = origin.inverse().after(pose)
    cells = occupancy_grid(found, frame.intrinsics, to_grid, frame.config.ground,
                           frame.config.grid)
    rows, columns = cells.shape
    corner_m = -resolution_m * rows / 2
    (place,) = pose_msgs(origin.points(np.array([[corner_m, corner_m, 0.0]])),
                         quaternions(origin.rotation[None]))
    return OccupancyGrid(
        header=header, data=array('b', cells.tobytes()),
        info=MapMetaData(map_load_time=header.stamp, resolution=resolution_m, width=columns,
                         height=rows, origin=place))
