# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Clouds of one point per plane, per corner of the outlines of planes, and per shape."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from sensor_msgs.msg import PointCloud2

from plane_detector.geometry.rigid_transform import quaternions
from plane_detector.ros.outputs.frame import DetectedFrame
from plane_detector.ros.outputs.messages import cloud_msg, plane_labels, shape_labels

PLANE_DTYPE = np.dtype([
    ('x', '<f4'), ('y', '<f4'), ('z', '<f4'),
    ('normal_x', '<f4'), ('normal_y', '<f4'), ('normal_z', '<f4'), ('d', '<f4'),
    ('label', '<u4'), ('num_inliers', '<u4'), ('rms', '<f4'), ('area', '<f4'),
    ('class', 'u1'), ('confidence', '<f4'),
    ('rect_x', '<f4'), ('rect_y', '<f4'), ('rect_z', '<f4'),
    ('rect_qx', '<f4'), ('rect_qy', '<f4'), ('rect_qz', '<f4'), ('rect_qw', '<f4'),
    ('rect_width', '<f4'), ('rect_height', '<f4'), ('merged', '<u4')], align=True)
CORNER_DTYPE = np.dtype([('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('label', '<u4'),
                         ('hole', 'u1'), ('polygon', '<u4')], align=True)
SHAPE_DTYPE = np.dtype([
    ('x', '<f4'), ('y', '<f4'), ('z', '<f4'),
    ('axis_x', '<f4'), ('axis_y', '<f4'), ('axis_z', '<f4'),
    ('radius', '<f4'), ('half_angle', '<f4'), ('length', '<f4'),
    ('type', 'u1'), ('label', '<u4'), ('num_inliers', '<u4'), ('rms', '<f4'),
    ('confidence', '<f4')], align=True)


def planes_to_msg(frame: DetectedFrame) -> PointCloud2:
    """Return the coefficients: one point per plane, at its centroid; no plane: an empty cloud."""
    detection, rectangles = frame.target_detection, frame.rectangles
    planes = detection.planes
    table = np.zeros(len(planes), PLANE_DTYPE)
    table['label'] = plane_labels(detection)
    table['class'], table['merged'] = detection.classes or 0, frame.merged or 0
    if planes:
        _set(table, ('x', 'y', 'z'), [plane.centroid_m for plane in planes])
        _set(table, ('normal_x', 'normal_y', 'normal_z'), [plane.normal for plane in planes])
        _set(table, ('d', 'num_inliers', 'rms', 'area', 'confidence'), [
            (plane.offset_m, plane.inlier_count, plane.rms_m, plane.area_m2, plane.confidence)
            for plane in planes])
        _set(table, ('rect_x', 'rect_y', 'rect_z'), [one.centre_m for one in rectangles])
        _set(table, ('rect_qx', 'rect_qy', 'rect_qz', 'rect_qw'),
             quaternions(np.stack([one.rotation for one in rectangles])))
        _set(table, ('rect_width', 'rect_height'), [(one.width_m, one.height_m)
                                                    for one in rectangles])
    return cloud_msg(frame.target_header, PLANE_DTYPE, table, 1, len(table))


def boundaries_to_msg(frame: DetectedFrame) -> PointCloud2:
    """Return one point per corner, in order; the last corner of a polygon repeats the first."""
    outlines = [(label, polygon) for label, of_plane
                in zip(plane_labels(frame.detection), frame.polygons, strict=True)
                for polygon in of_plane]
    closed_m = [np.zeros((0, 3))]
    for _, polygon in outlines:
        closed_m += polygon.corners_m, polygon.corners_m[:1]
    counts = [len(polygon.corners_m) + 1 for _, polygon in outlines]
    table = np.zeros(sum(counts), CORNER_DTYPE)
    table['x'], table['y'], table['z'] = np.concatenate(closed_m).T
    for name, values in (('label', [label for label, _ in outlines]),
                         ('hole', [polygon.is_hole for _, polygon in outlines]),
                         ('polygon', range(len(outlines)))):
        table[name] = np.repeat(np.array(values, CORNER_DTYPE[name]), counts)
    return cloud_msg(frame.target_header, CORNER_DTYPE, table, 1, len(table))


def shapes_to_msg(frame: DetectedFrame) -> PointCloud2:
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


def _set(table: np.ndarray, names: Sequence[str], rows: Sequence[Sequence[float]]) -> None:
    for name, column in zip(names, np.asarray(rows, float).T, strict=True):
        table[name] = column
