# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Spheres, cylinders and cones as a cloud of one point per shape."""

from __future__ import annotations

import numpy as np
from sensor_msgs.msg import PointCloud2

from plane_detector.ros.outputs.frame import ProcessedFrame
from plane_detector.ros.outputs.messages import cloud_msg, shape_labels

SHAPE_DTYPE = np.dtype([
    ('x', '<f4'), ('y', '<f4'), ('z', '<f4'),
    ('axis_x', '<f4'), ('axis_y', '<f4'), ('axis_z', '<f4'),
    ('radius', '<f4'), ('half_angle', '<f4'), ('length', '<f4'),
    ('type', 'u1'), ('label', '<u4'), ('num_inliers', '<u4'), ('rms', '<f4'),
    ('confidence', '<f4')], align=True)


def shapes_to_msg(frame: ProcessedFrame) -> PointCloud2:
    """
    Return one point per shape; without shapes an empty cloud.

    x y z is the centre of a sphere, the middle of a cylinder's axis, the apex of a cone; the axis
    is a unit vector, of a cone from the apex into it, and zero for a sphere.
    """
    detection = frame.target_detection
    table = np.zeros(len(detection.shapes), SHAPE_DTYPE)
    for row, shape, label in zip(table, detection.shapes, shape_labels(detection), strict=True):
        row['x'], row['y'], row['z'] = shape.position_m
        row['axis_x'], row['axis_y'], row['axis_z'] = shape.axis
        row['radius'], row['half_angle'] = shape.radius_m, shape.half_angle_rad
        row['length'], row['type'], row['label'] = shape.length_m, shape.type, label
        row['num_inliers'], row['rms'] = shape.inlier_count, shape.rms_m
        row['confidence'] = shape.confidence
    return cloud_msg(frame.target_header, SHAPE_DTYPE, table, 1, len(table))
