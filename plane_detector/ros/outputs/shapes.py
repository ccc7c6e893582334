# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Spheres, cylinders and cones as a cloud of one point per shape, and as markers."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import Marker

from plane_detector.drawing import label_colours
from plane_detector.ros.outputs.cdr import NO_POINTS, UNTURNED, MarkerValues
from plane_detector.ros.outputs.messages import cloud_msg, shape_labels
from plane_detector.types import Detection, Shape, ShapeType

NAMESPACE = 'shape'
SHAPE_DTYPE = np.dtype([
    ('x', '<f4'), ('y', '<f4'), ('z', '<f4'),
    ('axis_x', '<f4'), ('axis_y', '<f4'), ('axis_z', '<f4'),
    ('radius', '<f4'), ('half_angle', '<f4'), ('length', '<f4'),
    ('type', 'u1'), ('label', '<u4'), ('num_inliers', '<u4'), ('rms', '<f4'),
    ('confidence', '<f4')], align=True)
_ALPHA = 0.6
_CONE_SIDES = 24


def shapes_to_msg(header: Header, detection: Detection) -> PointCloud2:
    """
    Return one point per shape; without shapes an empty cloud.

    x y z is the centre of a sphere, the middle of a cylinder's axis, the apex of a cone; the axis
    is a unit vector, of a cone from the apex into it, and zero for a sphere.

    Parameters
    ----------
    header : std_msgs.msg.Header
        Of the image.
    detection : Detection

    """
    table = np.zeros(len(detection.shapes), SHAPE_DTYPE)
    for row, shape, label in zip(table, detection.shapes, shape_labels(detection), strict=True):
        row['x'], row['y'], row['z'] = shape.position_m
        row['axis_x'], row['axis_y'], row['axis_z'] = shape.axis
        row['radius'], row['half_angle'] = shape.radius_m, shape.half_angle_rad
        row['length'], row['type'], row['label'] = shape.length_m, shape.type, label
        row['num_inliers'], row['rms'] = shape.inlier_count, shape.rms_m
        row['confidence'] = shape.confidence
    return cloud_msg(header, SHAPE_DTYPE, table, 1, len(table))


def shape_markers(detection: Detection) -> Iterator[MarkerValues]:
    """Yield a marker of each shape: a sphere, a cylinder, or the triangles of a cone."""
    labels = shape_labels(detection)
    shares = (label_colours(labels) / 255.0).tolist()
    for shape, label, share in zip(detection.shapes, labels.tolist(), shares, strict=True):
        diameter_m = 2 * shape.radius_m
        kind, scale_m = {
            ShapeType.CONE: (Marker.TRIANGLE_LIST, (1.0, 1.0, 1.0)),
            ShapeType.CYLINDER: (Marker.CYLINDER, (diameter_m, diameter_m, shape.length_m)),
            ShapeType.SPHERE: (Marker.SPHERE, (diameter_m,) * 3)}[shape.type]
        yield MarkerValues(
            NAMESPACE, label, kind, Marker.ADD, (*share, _ALPHA), scale_m,
            _cone_corners(shape) if shape.type == ShapeType.CONE else NO_POINTS,
            tuple(np.asarray(shape.position_m, float).tolist()), _orientation(shape.axis))


def _cone_corners(shape: Shape) -> np.ndarray:
    """Return the corners (N, 3) of triangles about the z axis, from the apex at 0."""
    angles = np.linspace(0, 2 * np.pi, _CONE_SIDES + 1)
    radius_m = shape.length_m * np.tan(shape.half_angle_rad)
    rim_m = np.column_stack([radius_m * np.cos(angles), radius_m * np.sin(angles),
                             np.full(angles.size, shape.length_m)])
    return np.stack([np.zeros_like(rim_m[1:]), rim_m[:-1], rim_m[1:]], axis=1).reshape(-1, 3)


def _orientation(axis: np.ndarray) -> tuple[float, ...]:
    """Return a rotation x y z w that turns z into an axis; identity for a sphere."""
    if not np.any(axis):
        return UNTURNED
    rotation = Rotation.align_vectors(np.asarray(axis)[None], [[0.0, 0.0, 1.0]])[0]
    return tuple(rotation.as_quat().tolist())
