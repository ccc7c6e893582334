# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Clouds of the pixels of an image, back-projected and packed in one pass over the depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from plane_detector.compilation import kernel
from plane_detector.geometry.disparity import MIN_DEPTH_M
from plane_detector.geometry.projection import pixel_rays
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.ros.outputs.messages import POINT_DTYPE, XYZ_DTYPE, cloud_msg
from plane_detector.types import CameraIntrinsics

_STAY = RigidTransform.identity()


@dataclass(frozen=True)
class PixelPoints:
    """
    Input of the clouds: depth and labels of an image.

    Attributes
    ----------
    depth_m : (H, W) float32
        Metres along the optical axis; invalid as in :func:`~plane_detector.geometry.disparity`.
    labels : (H, W) int32
        Index of a plane or shape, -1 for none.
    intrinsics : CameraIntrinsics
        Of these images.
    to_target : RigidTransform or None
        From the optical frame into that of the clouds; None: they are equal.
    decimation : int
        The clouds contain every n-th row and column.

    """

    depth_m: np.ndarray
    labels: np.ndarray
    intrinsics: CameraIntrinsics
    to_target: RigidTransform | None = None
    decimation: int = 1

    def geometry(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return depth, slopes of columns and of rows, and the transform (3, 4), all float32."""
        ray_x, ray_y = pixel_rays(self.intrinsics)
        turn = self.to_target or _STAY
        moved = np.column_stack([turn.rotation, turn.translation_m]).astype(np.float32)
        return (self.thinned(self.depth_m, np.float32),
                np.ascontiguousarray(ray_x[::self.decimation]),
                np.ascontiguousarray(ray_y[::self.decimation]), moved)

    def thinned(self, image: np.ndarray, dtype: type) -> np.ndarray:
        """Return the pixels of an image that the clouds contain, C-contiguous."""
        return np.ascontiguousarray(image[::self.decimation, ::self.decimation], dtype)


def points_to_msg(header: Header, points: PixelPoints, rgb: np.ndarray,
                  names: np.ndarray) -> PointCloud2:
    """
    Return the organised, coloured and labelled cloud.

    Parameters
    ----------
    header : std_msgs.msg.Header
        Of the image, with the frame of the cloud.
    points : PixelPoints
        NaN where there is no depth.
    rgb : (H, W, 3) uint8
        The image; packed as PCL does, 0x00RRGGBB in the bits of a float.
    names : (K + 1,) uint32
        Label in the message of each index; the last entry is for no plane.

    """
    geometry = points.geometry()
    height, width = geometry[0].shape
    numbers = np.empty((height, width, POINT_DTYPE.itemsize // 4), '<f4')  # 4 bytes per field
    _pack_points(geometry, points.thinned(rgb, np.uint8), points.thinned(points.labels, np.int32),
                 _by_label(names), numbers, numbers.view('<u4'))
    return cloud_msg(header, POINT_DTYPE, numbers, height, width)


def obstacles_to_msg(header: Header, points: PixelPoints, is_left_out: np.ndarray) -> PointCloud2:
    """
    Return the valid points without those of some planes, unorganised, with fields x y z.

    Parameters
    ----------
    header : std_msgs.msg.Header
        Of the image, with the frame of the cloud.
    points : PixelPoints
    is_left_out : (K + 1,) bool
        For each index; the last entry is for no plane.

    """
    geometry = points.geometry()
    xyz_m = np.empty((geometry[0].size + 1, 3), '<f4')
    count = _pack_obstacles(geometry, points.thinned(points.labels, np.int32),
                            _by_label(is_left_out), xyz_m)
    return cloud_msg(header, XYZ_DTYPE, xyz_m[:count], 1, count)


def _by_label(values: np.ndarray) -> np.ndarray:
    """Return values with the last one, of -1, first: an index of 0 needs no wrap-around check."""
    return np.roll(values, 1)


# Read-only, for views of messages.
_DEPTH, _LABELS, _RGB = (f"Array({kind}, 'C', readonly=True)"
                         for kind in ('float32, 2', 'int32, 2', 'uint8, 3'))
_GEOMETRY = f'Tuple(({_DEPTH}, float32[::1], float32[::1], float32[:, ::1]))'


@kernel('UniTuple(UniTuple(float32, 4), 3)(float32[:, ::1])')
def _rows(m):
    return ((m[0, 0], m[0, 1], m[0, 2], m[0, 3]), (m[1, 0], m[1, 1], m[1, 2], m[1, 3]),
            (m[2, 0], m[2, 1], m[2, 2], m[2, 3]))


@kernel(f'void({_GEOMETRY}, {_RGB}, {_LABELS}, uint32[::1], float32[:, :, ::1], '
        'uint32[:, :, ::1])')
def _pack_points(geometry, rgb, labels, names, numbers, bits):
    """Fill (H, W, 5), viewed as floats and as bits: x y z, 0x00RRGGBB, label."""
    depth_m, ray_x, ray_y, moved = geometry
    # In variables: read from the array for every pixel, they take as long as all the rest.
    (a, b, c, d), (e, f, g, h), (i, j, k, m) = _rows(moved)
    for v in range(depth_m.shape[0]):
        for u in range(depth_m.shape[1]):
            z = depth_m[v, u]
            if not (z >= MIN_DEPTH_M and z < np.inf):
                z = np.float32(np.nan)
            x, y = z * ray_x[u], z * ray_y[v]
            numbers[v, u, 0] = a * x + b * y + c * z + d
            numbers[v, u, 1] = e * x + f * y + g * z + h
            numbers[v, u, 2] = i * x + j * y + k * z + m
            bits[v, u, 3] = ((np.uint32(rgb[v, u, 0]) << np.uint32(16))
                             | (np.uint32(rgb[v, u, 1]) << np.uint32(8)) | np.uint32(rgb[v, u, 2]))
            bits[v, u, 4] = names[np.uint32(labels[v, u] + 1)]


@kernel(f'int64({_GEOMETRY}, {_LABELS}, boolean[::1], float32[:, ::1])')
def _pack_obstacles(geometry, labels, is_left_out, xyz_m):
    """Fill the first rows of (N + 1, 3); return their number."""
    depth_m, ray_x, ray_y, moved = geometry
    (a, b, c, d), (e, f, g, h), (i, j, k, m) = _rows(moved)
    count = 0
    for v in range(depth_m.shape[0]):
        for u in range(depth_m.shape[1]):
            z = depth_m[v, u]
            x, y = z * ray_x[u], z * ray_y[v]
            # Every point is written, and the next one replaces it if it is none: no branch.
            xyz_m[count, 0] = a * x + b * y + c * z + d
            xyz_m[count, 1] = e * x + f * y + g * z + h
            xyz_m[count, 2] = i * x + j * y + k * z + m
            count += ((z >= MIN_DEPTH_M) & (z < np.inf)
                      & (not is_left_out[np.uint32(labels[v, u] + 1)]))
    return count
