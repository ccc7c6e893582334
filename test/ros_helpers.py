# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Messages and a ROS context of their own for the tests of the ROS side."""

from __future__ import annotations

import array

import numpy as np
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from plane_detector.types import CameraIntrinsics

FRAME_ID = 'camera_optical_frame'


def header(stamp_s: float = 0.0) -> Header:
    """Return a header of the camera with a stamp."""
    result = Header(frame_id=FRAME_ID)
    stamp_ns = round(stamp_s * 1e9)
    result.stamp.sec, result.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
    return result


def image_msg(pixels: np.ndarray, encoding: str, stamp_s: float = 0.0, padding: int = 0,
              big_endian: bool = False) -> Image:
    """Return pixels (H, W[, C]) as an Image whose rows end with bytes of 255."""
    if big_endian:
        pixels = pixels.astype(pixels.dtype.newbyteorder('>'))
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=255)
    msg = Image(header=header(stamp_s), height=pixels.shape[0], width=pixels.shape[1],
                encoding=encoding, step=rows.shape[1], is_bigendian=int(big_endian))
    msg.data = array.array('B', rows.tobytes())
    return msg


def camera_info_msg(intrinsics: CameraIntrinsics, stamp_s: float = 0.0) -> CameraInfo:
    """Return the CameraInfo of a pinhole camera."""
    msg = CameraInfo(header=header(stamp_s), width=intrinsics.width, height=intrinsics.height,
                     distortion_model='plumb_bob', d=[0.0] * 5)
    msg.k = [intrinsics.fx, 0.0, intrinsics.cx, 0.0, intrinsics.fy, intrinsics.cy, 0.0, 0.0, 1.0]
    msg.r = np.eye(3).ravel().tolist()
    msg.p = np.pad(np.reshape(msg.k, (3, 3)), ((0, 0), (0, 1))).ravel().tolist()
    return msg


def cloud_array(msg) -> np.ndarray:
    """Return a PointCloud2 as a structured array (height, width), read by its own fields."""
    types = {1: 'i1', 2: 'u1', 3: '<i2', 4: '<u2', 5: '<i4', 6: '<u4', 7: '<f4', 8: '<f8'}
    dtype = np.dtype({'names': [f.name for f in msg.fields],
                      'formats': [types[f.datatype] for f in msg.fields],
                      'offsets': [f.offset for f in msg.fields], 'itemsize': msg.point_step})
    assert not msg.is_bigendian
    assert msg.row_step == msg.width * msg.point_step
    assert len(msg.data) == msg.height * msg.row_step
    return np.frombuffer(msg.data, dtype).reshape(msg.height, msg.width)


def image_array(msg: Image, dtype: str, channels: int = 1) -> np.ndarray:
    """Return the pixels of an Image (H, W, channels) without padding."""
    return np.frombuffer(msg.data, dtype).reshape(msg.height, msg.width, channels)
