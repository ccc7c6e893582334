# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Clouds of the pixels of an image, of planes, of corners of their outlines, and of shapes.

Clouds of pixels are back-projected and packed in one pass over the depth.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from plane_detector._runtime.compilation import kernel
from plane_detector.drawing import tint
from plane_detector.geometry.disparity import MIN_DEPTH_M
from plane_detector.geometry.projection import pixel_rays
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.planes.outline import Polygon
from plane_detector.planes.plane_table import PLANE_DTYPE
from plane_detector.ros.outputs.frame import DetectedFrame
from plane_detector.ros.outputs.messages import (
    DROP_DTYPE,
    OBSTACLE_DTYPE,
    POINT_DTYPE,
    XYZ_DTYPE,
    cloud_msg,
    shape_labels,
)

CORNER_DTYPE = np.dtype([('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('label', '<u4'),
                         ('hole', 'u1'), ('polygon', '<u4')], align=True)
SHAPE_DTYPE = np.dtype([
    ('x', '<f4'), ('y', '<f4'), ('z', '<f4'),
    ('axis_x', '<f4'), ('axis_y', '<f4'), ('axis_z', '<f4'),
    ('radius', '<f4'), ('half_angle', '<f4'), ('length', '<f4'),
    ('type', 'u1'), ('label', '<u4'), ('num_inliers', '<u4'), ('rms', '<f4'),
    ('confidence', '<f4')], align=True)


def points_to_msg(frame: DetectedFrame) -> PointCloud2:
    """
    Return the organised, coloured and labelled cloud; NaN where there is no depth.

    Colours are packed as PCL does, 0x00RRGGBB in the bits of a float.
    """
    geometry = _geometry(frame)
    height, width = geometry[0].shape
    numbers = np.empty((height, width, POINT_DTYPE.itemsize // 4), '<f4')  # 4 bytes per field
    _pack_points(geometry, _thinned(frame, _colours(frame), np.uint8),
                 _thinned(frame, frame.labels, np.int32), numbers, numbers.view('<u4'))
    return cloud_msg(frame.target_header, POINT_DTYPE, numbers, height, width)


def points_without_floor_to_msg(frame: DetectedFrame) -> PointCloud2 | None:
    """Return the points of obstacles with height and sigma; None without gravity or the unit."""
    found = frame.detection.ground_result
    if not found.is_known:
        return None
    return _kept_to_msg(frame, OBSTACLE_DTYPE, found.obstacles,
                        (found.heights_m, found.height_sigmas_m))


def ground_to_msg(frame: DetectedFrame) -> PointCloud2 | None:
    """Return the points of the ground; None while gravity or the unit is unknown."""
    found = frame.detection.ground_result
    return _kept_to_msg(frame, XYZ_DTYPE, found.mask) if found.is_known else None


def drops_to_msg(frame: DetectedFrame) -> PointCloud2 | None:
    """Return points along the edges and how deep each drop is; None if none can be detected."""
    found = frame.detection.ground_result
    if found.drop_note:
        return None
    table = np.column_stack([frame.placed(found.drops_m), found.drop_depths_m]).astype('<f4')
    return cloud_msg(frame.target_header, DROP_DTYPE, table, 1, len(table))


def _kept_to_msg(frame: DetectedFrame, dtype: np.dtype, is_kept: np.ndarray,
                 more: Sequence[np.ndarray] = ()) -> PointCloud2:
    """Return the valid points of some pixels (H, W), unorganised: x y z, and ``more`` of each."""
    geometry = _geometry(frame)
    table = np.empty((geometry[0].size, 3 + len(more)), '<f4')
    values = tuple(_thinned(frame, one, np.float32) for one in more) or (geometry[0],) * 2
    count = _pack_kept(geometry, _thinned(frame, is_kept, bool), *values, table)
    return cloud_msg(frame.target_header, dtype, table[:count], 1, count)


def _colours(frame: DetectedFrame) -> np.ndarray:
    """Return the colours of the cloud, (H, W, 3) uint8."""
    if frame.settings.points_color == 'label':
        return tint(np.zeros_like(frame.rgb), frame.labels, frame.colours, share=1.0)
    if frame.settings.points_color == 'overlay':
        return tint(frame.rgb, frame.labels, frame.colours)
    return frame.rgb


def _geometry(frame: DetectedFrame) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return depth, slopes of columns and of rows, and the transform (3, 4), all float32."""
    step = frame.settings.points_decimation
    ray_x, ray_y = pixel_rays(frame.intrinsics)
    turn = frame.pose or RigidTransform.identity()
    moved = np.column_stack([turn.rotation, turn.translation_m]).astype(np.float32)
    return (_thinned(frame, frame.detection.depth_m, np.float32),
            np.ascontiguousarray(ray_x[::step]), np.ascontiguousarray(ray_y[::step]), moved)


def _thinned(frame: DetectedFrame, image: np.ndarray, dtype: type) -> np.ndarray:
    """Return the pixels of an image that the clouds contain, C-contiguous."""
    step = frame.settings.points_decimation
    return np.ascontiguousarray(image[::step, ::step], dtype)


# Read-only, for views of messages.
_DEPTH, _LABELS, _RGB, _MASK = (f"Array({kind}, 'C', readonly=True)" for kind in (
    'float32, 2', 'int32, 2', 'uint8, 3', 'boolean, 2'))
_GEOMETRY = f'Tuple(({_DEPTH}, float32[::1], float32[::1], float32[:, ::1]))'


@kernel('UniTuple(UniTuple(float32, 3), 3)(float32[:, ::1], float32)')
def _of_row(moved, y):
    """Return a, b, d of (a x + b) z + d, each coordinate of the points in a row of rays (x, y)."""
    # In variables: read from the array for every pixel, they would take as long as everything
    # else.
    return ((moved[0, 0], moved[0, 1] * y + moved[0, 2], moved[0, 3]),
            (moved[1, 0], moved[1, 1] * y + moved[1, 2], moved[1, 3]),
            (moved[2, 0], moved[2, 1] * y + moved[2, 2], moved[2, 3]))


@kernel(f'void({_GEOMETRY}, {_RGB}, {_LABELS}, float32[:, :, ::1], uint32[:, :, ::1])')
def _pack_points(geometry, rgb, labels, numbers, bits):
    """Fill (H, W, 5), viewed as floats and as bits: x y z, 0x00RRGGBB, label."""
    depth_m, ray_x, ray_y, moved = geometry
    nearest, endless = np.float32(MIN_DEPTH_M), np.float32(np.inf)
    nothing = np.float32(np.nan)
    for v in range(depth_m.shape[0]):
        (a, b, d), (e, f, h), (i, j, m) = _of_row(moved, ray_y[v])
        for u in range(depth_m.shape[1]):
            z, x = depth_m[v, u], ray_x[u]
            z = z if (z >= nearest) & (z < endless) else nothing
            numbers[v, u, 0] = (a * x + b) * z + d
            numbers[v, u, 1] = (e * x + f) * z + h
            numbers[v, u, 2] = (i * x + j) * z + m
            bits[v, u, 3] = ((np.uint32(rgb[v, u, 0]) << np.uint32(16))
                             | (np.uint32(rgb[v, u, 1]) << np.uint32(8)) | np.uint32(rgb[v, u, 2]))
            bits[v, u, 4] = np.uint32(labels[v, u])


@kernel(f'int64({_GEOMETRY}, {_MASK}, {_DEPTH}, {_DEPTH}, float32[:, ::1])')
def _pack_kept(geometry, is_kept, heights_m, sigmas_m, table):
    """Fill the first rows of (N, 3), or of (N, 5) with height and sigma; return their number."""
    depth_m, ray_x, ray_y, moved = geometry
    count = 0
    for v in range(depth_m.shape[0]):
        (a, b, d), (e, f, h), (i, j, m) = _of_row(moved, ray_y[v])
        for u in range(depth_m.shape[1]):
            z, x = depth_m[v, u], ray_x[u]
            if not is_kept[v, u] or not (z >= MIN_DEPTH_M and z < np.inf):
                continue
            table[count, 0] = (a * x + b) * z + d
            table[count, 1] = (e * x + f) * z + h
            table[count, 2] = (i * x + j) * z + m
            if table.shape[1] == 5:
                table[count, 3], table[count, 4] = heights_m[v, u], sigmas_m[v, u]
            count += 1
    return count


def planes_to_msg(frame: DetectedFrame) -> PointCloud2:
    """Return the coefficients: one point per plane, at its centroid; no plane: an empty cloud."""
    table = frame.plane_table
    return cloud_msg(frame.target_header, PLANE_DTYPE, table, 1, len(table))


def boundaries_to_msg(frame: DetectedFrame) -> PointCloud2:
    """Return one point per corner, in order; the last corner of a polygon repeats the first."""
    return corners_to_msg(frame.target_header, [
        (label, polygon) for label, of_plane
        in zip(frame.detection.planes.labels, frame.polygons, strict=True)
        for polygon in of_plane])


def corners_to_msg(header: Header, outlines: Sequence[tuple[int, Polygon]]) -> PointCloud2:
    """Return the corners of the outlines of labels; the last of a polygon repeats the first."""
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
    return cloud_msg(header, CORNER_DTYPE, table, 1, len(table))


def shapes_to_msg(frame: DetectedFrame) -> PointCloud2 | None:
    """
    Return one point per shape, an empty cloud if there are none; None if they are not searched
    for.

    x y z is the centre of a sphere, the middle of a cylinder's axis, the apex of a cone; the axis
    is a unit vector, of a cone from the apex into it, and zero for a sphere.
    """
    if frame.detection.shape_note:
        return None
    table = np.zeros(len(frame.shapes), SHAPE_DTYPE)
    for row, shape, label in zip(table, frame.shapes, shape_labels(frame.detection), strict=True):
        row['x'], row['y'], row['z'] = shape.position_m
        row['axis_x'], row['axis_y'], row['axis_z'] = shape.axis
        row['radius'], row['half_angle'] = shape.radius_m, shape.half_angle_rad
        row['length'], row['type'], row['label'] = shape.length_m, shape.type, label
        row['num_inliers'], row['rms'] = shape.inlier_count, shape.rms_m
        row['confidence'] = shape.confidence
    return cloud_msg(frame.target_header, SHAPE_DTYPE, table, 1, len(table))
