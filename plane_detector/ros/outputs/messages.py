# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Conversion of the results of the core to messages, without state, and of clouds to arrays.

Every output has the header of its image, so that stamp and optical frame (REP-103) are those of
the image. Labels in messages are above 0; 0 means no plane.
"""

from __future__ import annotations

from functools import cache
from typing import Any, TypeVar

import cv2
import numpy as np
from geometry_msgs.msg import Point, Pose, PoseArray, Quaternion
from sensor_msgs.msg import CompressedImage, Image, PointCloud2, PointField
from std_msgs.msg import Header

from plane_detector.geometry.rigid_transform import quaternions
from plane_detector.types import Detection, Planes

FIRST_SHAPE_LABEL = 32768
"""Labels of shapes are above this, those of planes below."""
POINT_DTYPE = np.dtype([('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('rgb', '<f4'),
                        ('label', '<u4')])
XYZ_DTYPE = np.dtype([('x', '<f4'), ('y', '<f4'), ('z', '<f4')])
OBSTACLE_DTYPE = np.dtype([*XYZ_DTYPE.descr, ('height', '<f4'), ('sigma', '<f4')])
DROP_DTYPE = np.dtype([*XYZ_DTYPE.descr, ('drop', '<f4')])
Message = TypeVar('Message', CompressedImage, Image, PointCloud2)
_TYPES = {PointField.INT8: 'i1', PointField.UINT8: 'u1', PointField.INT16: 'i2',
          PointField.UINT16: 'u2', PointField.INT32: 'i4', PointField.UINT32: 'u4',
          PointField.FLOAT32: 'f4', PointField.FLOAT64: 'f8'}
_FIELD_TYPES = {kind: number for number, kind in _TYPES.items()}


def shape_labels(detection: Detection) -> np.ndarray:
    """Return the label of each shape in the messages, (S,) uint32."""
    return np.array([FIRST_SHAPE_LABEL + shape.label for shape in detection.shapes], np.uint32)


def assembled(kind: type, **slots: Any) -> Any:
    """Return a message from all its slots; a constructor would first make a default for each."""
    msg = kind.__new__(kind)
    msg._check_fields = False
    for name, value in slots.items():
        setattr(msg, name, value)
    return msg


def poses_to_msg(header: Header, planes: Planes) -> PoseArray:
    """
    Return the pose of each plane: its centroid, z along the normal.

    The x axis is the camera's x axis projected onto the plane (its y axis if that is the normal).
    """
    z_axes = planes.normals
    reference = np.eye(3)[np.where(abs(z_axes[:, 0]) > 0.9, 1, 0)]
    x_axes = reference - (reference * z_axes).sum(axis=1, keepdims=True) * z_axes
    x_axes /= np.linalg.norm(x_axes, axis=1, keepdims=True)
    axes = np.stack([x_axes, np.cross(z_axes, x_axes), z_axes], axis=2)
    return PoseArray(header=header, poses=pose_msgs(planes.centroids_m, quaternions(axes)))


def pose_msgs(points_m: np.ndarray, rotations: np.ndarray) -> list[Pose]:
    """Return poses as messages from their points (N, 3) and their quaternions (N, 4), x y z w."""
    return [assembled(Pose, _position=point,
                      _orientation=assembled(Quaternion, _x=x, _y=y, _z=z, _w=w))
            for point, (x, y, z, w) in zip(point_msgs(points_m), rotations.tolist(), strict=True)]


def point_msgs(points_m: np.ndarray) -> list[Point]:
    """Return points (N, 3) as messages."""
    points = []
    for x_m, y_m, z_m in np.asarray(points_m).tolist():
        point = Point.__new__(Point)  # as in `assembled`, because there are many
        point._x, point._y, point._z, point._check_fields = x_m, y_m, z_m, False
        points.append(point)
    return points


def labels_to_msg(header: Header, labels: np.ndarray) -> Image:
    """Return the label image (H, W) as 16UC1."""
    return _image_msg(header, '16UC1', labels.astype('<u2', copy=False))


def depth_to_msg(header: Header, depth_m: np.ndarray) -> Image:
    """Return the depth image (H, W), metres with NaN for invalid, as 32FC1."""
    return _image_msg(header, '32FC1', depth_m.astype('<f4', copy=False))


def rgb_to_msg(header: Header, rgb: np.ndarray) -> Image:
    """Return the image (H, W, 3) uint8 as rgb8."""
    return _image_msg(header, 'rgb8', rgb)


def jpeg_to_msg(header: Header, rgb: np.ndarray) -> CompressedImage:
    """Return the image (H, W, 3) uint8 as JPEG, in the form of compressed_image_transport."""
    _, data = cv2.imencode('.jpg', cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
    return _sharing(CompressedImage(header=header, format='rgb8; jpeg compressed bgr8'), data)


def cloud_msg(header: Header, dtype: np.dtype, data: np.ndarray, height: int,
              width: int) -> PointCloud2:
    """Return a cloud whose points have a structured type; it shares the data, C-contiguous."""
    msg = PointCloud2(header=header, height=height, width=width, fields=list(_fields(dtype)),
                      is_bigendian=False, point_step=dtype.itemsize,
                      row_step=dtype.itemsize * width, is_dense=dtype is not POINT_DTYPE,
                      check_fields=True)
    return _sharing(msg, data)


@cache
def _fields(dtype: np.dtype) -> tuple[PointField, ...]:
    """Return the fields of a structured type, which all clouds share."""
    return tuple(PointField(name=name, offset=offset, count=1,
                            datatype=_FIELD_TYPES[kind.str[1:]])
                 for name, (kind, offset) in dtype.fields.items())


def _image_msg(header: Header, encoding: str, pixels: np.ndarray) -> Image:
    msg = Image(header=header, height=pixels.shape[0], width=pixels.shape[1], encoding=encoding,
                is_bigendian=0, step=pixels.nbytes // pixels.shape[0], check_fields=True)
    return _sharing(msg, pixels)


def _sharing(msg: Message, data: np.ndarray) -> Message:
    """
    Use the bytes of an array as the data of a message.

    The setter would copy them into a new array.array, whose memory Python clears first: 6 MB a
    frame for a cloud. The middleware takes any buffer, and copies it when it is published.
    """
    msg._data = np.ascontiguousarray(data).reshape(-1).view(np.uint8).data
    return msg


def read_cloud(msg: PointCloud2) -> np.ndarray:
    """Return the points, a structured array (height, width) that shares the message's memory."""
    order = '>' if msg.is_bigendian else '<'
    dtype = np.dtype({'names': [field.name for field in msg.fields],
                      'formats': [order + _TYPES[field.datatype] for field in msg.fields],
                      'offsets': [field.offset for field in msg.fields],
                      'itemsize': msg.point_step})
    rows = np.frombuffer(msg.data, np.uint8).reshape(msg.height, msg.row_step)
    return rows[:, :msg.width * msg.point_step].view(dtype)
