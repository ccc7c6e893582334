# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Measured depth from messages: images (REP-118), compressedDepth, organised point clouds.

compressedDepth is the transport of compressed_depth_image_transport: 12 bytes, then a PNG file of
16 bits, or width, height and RVL data. For an image in metres it holds rounded inverse depth.
"""

from __future__ import annotations

import struct
from functools import lru_cache

import cv2
import numpy as np
from sensor_msgs.msg import CompressedImage, Image, PointCloud2, PointField

from plane_detector.depth.preprocessing import rays
from plane_detector.geometry.disparity import limited_depth
from plane_detector.ros.inputs.image_decoding import compressed_size, decompressed, pixels_of
from plane_detector.ros.inputs.rvl import decode_rvl
from plane_detector.types import CameraIntrinsics

# By encoding: type of the numbers, and metres per raw unit.
_ENCODINGS = {'32fc1': ('f4', 1.0), 'r_float32': ('f4', 1.0), '16uc1': ('u2', 0.001),
              'mono16': ('u2', 0.001)}
COMPRESSED_DEPTH = '/compressedDepth'
_HEADER, _SIZE = struct.Struct('<iff'), struct.Struct('<II')
_FIELD_TYPES = {PointField.FLOAT32: 'f4', PointField.FLOAT64: 'f8'}
# chosen: an unrectified lens rotates rays by less; a different frame rotates them by far more.
_MOST_OFF_RAY = 0.1
_CHECKED_STEP = 8


def depth_from_msg(msg: Image | CompressedImage | PointCloud2, most_pixels: int,
                   unit_m: float = 0.0) -> np.ndarray:
    """
    Decode measured depth.

    Parameters
    ----------
    msg : sensor_msgs.msg.Image, CompressedImage or PointCloud2
        Encoding 32FC1 or R_FLOAT32 (metres; not finite or not positive is invalid) or 16UC1
        (millimetres; 0 is invalid), also under the name mono16; compressedDepth of these; or an
        organised cloud with z in metres in the optical frame.
    most_pixels : int
        A compressed image of more pixels is rejected.
    unit_m : float
        Metres per raw unit; 0: as above.

    Returns
    -------
    (H, W) float32
        Metres, NaN where invalid.

    Raises
    ------
    ValueError
        The encoding is not supported, the data is damaged, inconsistent or too large, or the cloud
        is not organised.

    """
    if isinstance(msg, PointCloud2):
        return limited_depth(_field(msg, 'z') * (unit_m or 1.0))
    compressed = isinstance(msg, CompressedImage)
    encoding = (msg.format.partition(';')[0] if compressed else msg.encoding).strip()
    if encoding.lower() not in _ENCODINGS:
        raise ValueError(f'depth encoding {encoding!r} is not supported: 32FC1 (metres) and 16UC1 '
                         '(millimetres) are')
    number_type, by_encoding_m = _ENCODINGS[encoding.lower()]
    if compressed:
        numbers = _decompressed(msg, number_type, most_pixels)
    else:
        numbers = pixels_of(msg, number_type, 1)[..., 0]
    factor = np.float32(unit_m or by_encoding_m)
    return limited_depth(numbers if factor == 1 else numbers * factor)


def is_compressed_depth(msg: CompressedImage) -> bool:
    """Return whether a compressed image is depth, by its format."""
    return 'compresseddepth' in msg.format.lower()


def depth_size(msg: Image | CompressedImage | PointCloud2) -> tuple[int, int]:
    """Return width and height of a depth message, 0 if it is damaged, without decoding it."""
    if not isinstance(msg, CompressedImage):
        return msg.width, msg.height
    payload = bytes(msg.data)[_HEADER.size:]
    try:
        return (_SIZE.unpack_from(payload) if _is_rvl(msg) else compressed_size(payload))
    except (ValueError, struct.error):
        return 0, 0


def _is_rvl(msg: CompressedImage) -> bool:
    return 'rvl' in msg.format.lower()


def _decompressed(msg: CompressedImage, number_type: str, most_pixels: int) -> np.ndarray:
    """Return the numbers of a compressedDepth message."""
    data = bytes(msg.data)
    if len(data) < _HEADER.size + _SIZE.size:
        raise ValueError(f'the compressedDepth message has only {len(data)} bytes')
    _, factor, shift = _HEADER.unpack_from(data)
    payload = data[_HEADER.size:]
    if _is_rvl(msg):
        width, height = _SIZE.unpack_from(payload)
        _check_size(width, height, most_pixels)
        counts = decode_rvl(payload[_SIZE.size:], width * height).reshape(height, width)
    else:
        try:
            size = compressed_size(payload)
        except ValueError as error:
            raise ValueError('the compressedDepth message cannot be decoded: after 12 bytes, '
                             f'{error}; its format is {msg.format!r}') from error
        _check_size(*size, most_pixels)
        counts = decompressed(payload, size, cv2.IMREAD_UNCHANGED)
        if counts.ndim != 2 or counts.dtype != np.uint16:
            raise ValueError('the image of the compressedDepth message does not have 16 bits')
    if number_type == 'u2':
        return counts
    with np.errstate(all='ignore'):  # by a hostile header
        return np.where(counts, factor / (counts - np.float32(shift)), np.nan)


def _check_size(width: int, height: int, most_pixels: int) -> None:
    if not 0 < width * height <= most_pixels:
        raise ValueError(f'the compressedDepth image is {width} x {height}; 1 to {most_pixels} '
                         'pixels are accepted')


def check_rays(msg: PointCloud2, intrinsics: CameraIntrinsics) -> None:
    """Raise ValueError if the points of an organised cloud are not on the rays of their pixels."""
    x_m, y_m, z_m = (_field(msg, name)[::_CHECKED_STEP, ::_CHECKED_STEP] for name in 'xyz')
    own = _checked_rays(intrinsics, (msg.height, msg.width))
    with np.errstate(all='ignore'):  # NaN where nothing was measured
        off = abs(x_m / z_m - own[..., 0]) + abs(y_m / z_m - own[..., 1])
    off = off[np.isfinite(off)]
    if len(off) and np.median(off) > _MOST_OFF_RAY:
        raise ValueError('the points of the cloud are not on the rays of their pixels: the cloud '
                         'must be in the optical frame of the camera (z forward), and CameraInfo '
                         'must match its pixels')


@lru_cache(maxsize=4)
def _checked_rays(intrinsics: CameraIntrinsics, shape: tuple[int, int]) -> np.ndarray:
    return rays(intrinsics, shape)[::_CHECKED_STEP, ::_CHECKED_STEP].copy()


def _field(msg: PointCloud2, name: str) -> np.ndarray:
    """Return a field (height, width) of an organised cloud, a view of its data."""
    if min(msg.height, msg.width) < 2:
        raise ValueError(f'the point cloud is not organised: it is {msg.width} x {msg.height}; '
                         'the driver may have a setting for this')
    if msg.row_step < msg.width * msg.point_step or len(msg.data) != msg.height * msg.row_step:
        raise ValueError(f'the data of the point cloud has {len(msg.data)} bytes, but it is '
                         f'{msg.width} x {msg.height} points of {msg.point_step} bytes')
    found = [field for field in msg.fields if field.name == name]
    if len(found) != 1 or found[0].datatype not in _FIELD_TYPES:
        raise ValueError(f'the point cloud has no field {name} of type FLOAT32 or FLOAT64')
    dtype = np.dtype(_FIELD_TYPES[found[0].datatype]).newbyteorder(
        '>' if msg.is_bigendian else '<')
    if found[0].offset + dtype.itemsize > msg.point_step:
        raise ValueError(f'field {name} of the point cloud is beyond its {msg.point_step} bytes')
    return np.ndarray((msg.height, msg.width), dtype, msg.data, found[0].offset,
                      (msg.row_step, msg.point_step))
