# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Image messages to arrays.

The encodings are those of sensor_msgs/image_encodings.hpp and of REP-118 for depth. A row takes
``step`` bytes, of which the pixels may leave some unused; ``is_bigendian`` matters where a
channel has more than one byte.
"""

from __future__ import annotations

import cv2
import numpy as np
from sensor_msgs.msg import CompressedImage, Image

_CHANNELS = {'rgb8': 3, 'bgr8': 3, 'rgba8': 4, 'bgra8': 4, 'mono8': 1,
             'uyvy': 2, 'yuv422': 2, 'yuyv': 2, 'yuv422_yuy2': 2,
             'bayer_rggb8': 1, 'bayer_bggr8': 1, 'bayer_gbrg8': 1, 'bayer_grbg8': 1}
# OpenCV names a Bayer pattern after the second row, second column; ROS after the first pixels.
_TO_RGB = {'bgr8': cv2.COLOR_BGR2RGB, 'rgba8': cv2.COLOR_RGBA2RGB, 'bgra8': cv2.COLOR_BGRA2RGB,
           'mono8': cv2.COLOR_GRAY2RGB,
           'uyvy': cv2.COLOR_YUV2RGB_UYVY, 'yuv422': cv2.COLOR_YUV2RGB_UYVY,
           'yuyv': cv2.COLOR_YUV2RGB_YUYV, 'yuv422_yuy2': cv2.COLOR_YUV2RGB_YUYV,
           'bayer_rggb8': cv2.COLOR_BayerBG2RGB, 'bayer_bggr8': cv2.COLOR_BayerRG2RGB,
           'bayer_gbrg8': cv2.COLOR_BayerGR2RGB, 'bayer_grbg8': cv2.COLOR_BayerGB2RGB}


def rgb_from_msg(msg: Image) -> np.ndarray:
    """
    Decode a colour or grey picture.

    Parameters
    ----------
    msg : sensor_msgs.msg.Image
        Encoding rgb8, bgr8, rgba8, bgra8, mono8, mono16, yuv422 (also called uyvy), yuv422_yuy2
        (also called yuyv) or bayer_{rggb,bggr,gbrg,grbg}8.

    Returns
    -------
    (H, W, 3) uint8
        It may share the memory of the message.

    Raises
    ------
    ValueError
        The encoding is another one, or size, step and length of the data do not agree.

    """
    encoding = msg.encoding.lower()
    if encoding == 'mono16':
        grey = (_pixels(msg, 'u2', 1)[..., 0] >> 8).astype(np.uint8)
        return cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB)
    if encoding not in _CHANNELS:
        raise ValueError(f'image encoding {msg.encoding!r} is not known; known are '
                         f'{", ".join(_CHANNELS)}, mono16')
    pixels = _pixels(msg, 'u1', _CHANNELS[encoding])
    if encoding not in _TO_RGB:
        return pixels
    _check_sides(msg, encoding)
    return cv2.cvtColor(np.ascontiguousarray(pixels), _TO_RGB[encoding])


def rgb_from_compressed_msg(msg: CompressedImage) -> np.ndarray:
    """
    Decode a jpeg or png picture to (H, W, 3) uint8.

    Raises
    ------
    ValueError
        The data is no picture that OpenCV can read.

    """
    data = np.frombuffer(msg.data, np.uint8)
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    bgr = cv2.imdecode(data, flags) if data.size else None
    if bgr is None:
        raise ValueError(f'the compressed image ({msg.format!r}, {data.size} bytes) cannot be '
                         'decoded: jpeg and png are')
    return cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)


def depth_from_msg(msg: Image) -> np.ndarray:
    """
    Decode a depth image (REP-118).

    Parameters
    ----------
    msg : sensor_msgs.msg.Image
        Encoding 32FC1 (metres; not finite or not positive is invalid) or 16UC1 (millimetres;
        0 is invalid), also under the name mono16.

    Returns
    -------
    (H, W) float32
        Metres, NaN where invalid.

    Raises
    ------
    ValueError
        The encoding is another one, or size, step and length of the data do not agree.

    """
    encoding = msg.encoding.upper()
    if encoding == '32FC1':
        depth_m = _pixels(msg, 'f4', 1)[..., 0].astype(np.float32)
    elif encoding in ('16UC1', 'MONO16'):
        depth_m = _pixels(msg, 'u2', 1)[..., 0] * np.float32(0.001)
    else:
        raise ValueError(f'depth encoding {msg.encoding!r} is not known: 32FC1 (metres) and '
                         '16UC1 (millimetres) are')
    depth_m[~((depth_m > 0) & (depth_m < np.inf))] = np.nan
    return depth_m


def _pixels(msg: Image, channel_type: str, channels: int) -> np.ndarray:
    """Return the message's pixels (H, W, channels), a view of its data without the padding."""
    dtype = np.dtype(channel_type).newbyteorder('>' if msg.is_bigendian else '<')
    row_bytes = msg.width * channels * dtype.itemsize
    if not row_bytes or not msg.height:
        raise ValueError(f'the image is empty: {msg.width} x {msg.height}')
    if msg.step < row_bytes:
        raise ValueError(f'step is {msg.step}, but a row of {msg.width} {msg.encoding} pixels '
                         f'takes {row_bytes} bytes')
    if len(msg.data) != msg.height * msg.step:
        raise ValueError(f'the data has {len(msg.data)} bytes, but height x step is '
                         f'{msg.height} x {msg.step}')
    rows = np.frombuffer(msg.data, np.uint8).reshape(msg.height, msg.step)[:, :row_bytes]
    return np.ascontiguousarray(rows).view(dtype).reshape(msg.height, msg.width, channels)


def _check_sides(msg: Image, encoding: str) -> None:
    """Colour that is shared between neighbouring pixels needs those neighbours."""
    if _CHANNELS[encoding] == 2 and msg.width % 2:
        raise ValueError(f'the width of a {msg.encoding} image must be even, not {msg.width}')
    if encoding.startswith('bayer') and min(msg.width, msg.height) < 3:
        raise ValueError(f'a {msg.encoding} image of {msg.width} x {msg.height} is too small')
