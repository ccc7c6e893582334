# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Decoding of image messages to arrays.

The encodings are those of sensor_msgs/image_encodings.hpp and of REP-118 for depth. A row has
``step`` bytes, which may include padding; ``is_bigendian`` matters for channels of more than one
byte.
"""

from __future__ import annotations

import struct

import cv2
import numpy as np
from sensor_msgs.msg import CompressedImage, Image

_CHANNELS = {'rgb8': 3, 'bgr8': 3, 'rgba8': 4, 'bgra8': 4, 'mono8': 1, '8uc1': 1,
             'uyvy': 2, 'yuv422': 2, 'yuyv': 2, 'yuv422_yuy2': 2,
             '8uc3': 3, 'bayer_rggb8': 1, 'bayer_bggr8': 1, 'bayer_gbrg8': 1, 'bayer_grbg8': 1}
# OpenCV names a Bayer pattern after the second row and column; ROS after the first pixels. 8UC3
# does not define its channels; they are BGR as in OpenCV, from which the name comes.
_TO_RGB = {'bgr8': cv2.COLOR_BGR2RGB, '8uc3': cv2.COLOR_BGR2RGB,
           'rgba8': cv2.COLOR_RGBA2RGB, 'bgra8': cv2.COLOR_BGRA2RGB,
           'mono8': cv2.COLOR_GRAY2RGB, '8uc1': cv2.COLOR_GRAY2RGB,
           'uyvy': cv2.COLOR_YUV2RGB_UYVY, 'yuv422': cv2.COLOR_YUV2RGB_UYVY,
           'yuyv': cv2.COLOR_YUV2RGB_YUYV, 'yuv422_yuy2': cv2.COLOR_YUV2RGB_YUYV,
           'bayer_rggb8': cv2.COLOR_BayerBG2RGB, 'bayer_bggr8': cv2.COLOR_BayerRG2RGB,
           'bayer_gbrg8': cv2.COLOR_BayerGR2RGB, 'bayer_grbg8': cv2.COLOR_BayerGB2RGB}
# The luma of all pixels, followed by the colour of each 2 x 2 block, half as many rows.
_HALF_COLOUR = {'nv12': cv2.COLOR_YUV2RGB_NV12, 'nv21': cv2.COLOR_YUV2RGB_NV21}
DEPTH_ENCODINGS = ('16uc1', '32fc1', 'r_float32')
"""Encodings used only for depth, in lower case."""
# derived: PNG is ISO/IEC 15948, JPEG is ITU-T T.81, annex B.
_PNG_BEGIN = b'\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR'
_PNG_SIGNATURE_BYTES = 8
_PNG_CHUNK_BYTES = 12  # length, type and checksum of a chunk
_JPEG_BEGIN = b'\xff\xd8\xff'
_START_OF_SCAN = b'\xff\xda'
# Markers of a frame header: C0 to CF, except tables and reserved markers.
_FRAME_MARKERS = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_NO_SEGMENT = {0x01, *range(0xD0, 0xD9)}
MOST_SCANS = 100
"""
Largest number of scans of a JPEG; encoders write 10 to 20, and each is a pass over the image.
"""


def rgb_from_msg(msg: Image) -> np.ndarray:
    """
    Decode a colour or grey image.

    Parameters
    ----------
    msg : sensor_msgs.msg.Image
        Encoding rgb8, bgr8, rgba8, bgra8, mono8, bayer_{rggb,bggr,gbrg,grbg}8 or one of these with
        16 bits, of which the upper 8 are used; yuv422 (also called uyvy), yuv422_yuy2 (also called
        yuyv), nv12, nv21, 8UC3 (as bgr8) or 8UC1 (as mono8).

    Returns
    -------
    (H, W, 3) uint8
        It may share the memory of the message.

    Raises
    ------
    ValueError
        The encoding is not supported, or size, step and length of the data are inconsistent.

    """
    encoding = msg.encoding.lower()
    if encoding in _HALF_COLOUR:
        _check_sides(msg, encoding)
        rows = pixels_of(msg, 'u1', 1, msg.height * 3 // 2)
        return cv2.cvtColor(rows, _HALF_COLOUR[encoding])
    if encoding in DEPTH_ENCODINGS:
        raise ValueError(f'the image is depth ({msg.encoding}): remap its topic to depth, set '
                         'depth.source to topic, and remap the colour image to image, or set '
                         'depth.colour to none')
    as_8_bit = encoding.removesuffix('16') + '8' if encoding.endswith('16') else encoding
    if as_8_bit not in _CHANNELS:
        raise ValueError(f'image encoding {msg.encoding!r} is not known; known are '
                         f'{", ".join((*_CHANNELS, *_HALF_COLOUR))}, and 16 instead of 8 bits')
    has_16_bit = as_8_bit != encoding
    pixels = pixels_of(msg, 'u2' if has_16_bit else 'u1', _CHANNELS[as_8_bit])
    if has_16_bit:
        pixels = (pixels >> 8).astype(np.uint8)
    if as_8_bit not in _TO_RGB:
        return pixels
    _check_sides(msg, as_8_bit)
    return cv2.cvtColor(np.ascontiguousarray(pixels), _TO_RGB[as_8_bit])


def rgb_from_compressed_msg(msg: CompressedImage, expected: tuple[int, int],
                            most_pixels: int) -> np.ndarray:
    """
    Decode a JPEG or PNG image after checking the size in its header.

    Parameters
    ----------
    msg : sensor_msgs.msg.CompressedImage
        Its ``format`` is ignored; the first bytes identify the format.
    expected : (width, height)
        Its size; (0, 0) if not known.
    most_pixels : int
        Larger images are rejected.

    Returns
    -------
    (H, W, 3) uint8

    Raises
    ------
    ValueError
        The data is not such an image, is damaged, or has another size.

    """
    data = bytes(msg.data)
    try:
        size = compressed_size(data)
    except ValueError as error:
        raise ValueError(f'the compressed image ({len(data)} bytes) cannot be decoded: '
                         f'{error}') from error
    if any(expected) and size != expected:
        raise ValueError(wrong_size(size, expected))
    check_pixels(size, most_pixels)
    bgr = decompressed(data, size, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    return cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)


def check_pixels(size: tuple[int, int], most_pixels: int) -> None:
    """Raise ValueError if an image of this width and height is too large."""
    if size[0] * size[1] > most_pixels:
        raise ValueError(f'the image is {size[0]} x {size[1]}, more than max_image_pixels, '
                         f'{most_pixels}: reduce it in the driver, or raise max_image_pixels and, '
                         'to save time, set max_side')


def compressed_size(data: bytes) -> tuple[int, int]:
    """
    Return width and height from the header of a JPEG or PNG file.

    A file of a few hundred bytes may declare an image of gigabytes.

    Parameters
    ----------
    data : bytes
        The file.

    Raises
    ------
    ValueError
        It is neither, has no such header, is empty, is a PNG whose chunks are longer than the
        file, or a JPEG with too many scans.

    """
    if data.startswith(_PNG_BEGIN):
        _check_png_chunks(data)
        size = struct.unpack('>II', data[16:24])
    elif data.startswith(_JPEG_BEGIN):
        size = _jpeg_size(data)
        if (scans := data.count(_START_OF_SCAN)) > MOST_SCANS:
            raise ValueError(f'it is a JPEG file of {scans} scans, more than {MOST_SCANS}')
    else:
        raise ValueError('it is neither a JPEG nor a PNG file')
    if 0 in size:
        raise ValueError('its header declares no size')
    return size


def _check_png_chunks(data: bytes) -> None:
    """Reject truncated chunks: OpenCV 5.0 allocates memory for the declared lengths."""
    at = _PNG_SIGNATURE_BYTES
    while at + _PNG_CHUNK_BYTES <= len(data):
        (length,) = struct.unpack('>I', data[at:at + 4])
        at += _PNG_CHUNK_BYTES + length
        if at <= len(data) and data[at - length - 8:at - length - 4] == b'IEND':
            return
    raise ValueError('it is a truncated PNG file')


def _jpeg_size(data: bytes) -> tuple[int, int]:
    """Skip segments up to the frame header; return (0, 0) if there is none."""
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker in _FRAME_MARKERS:
            height, width = struct.unpack('>HH', data[at + 5:at + 9])
            return width, height
        if marker == 0xFF:  # padding
            at += 1
        elif marker in _NO_SEGMENT:
            at += 2
        else:
            at += 2 + max(struct.unpack('>H', data[at + 2:at + 4])[0], 2)
    return 0, 0


def decompressed(data: bytes, size: tuple[int, int], flags: int) -> np.ndarray:
    """Return the pixels of a JPEG or PNG file, decoded by OpenCV; ValueError if it is damaged."""
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        reason = ' '.join(error.err.split())
        raise ValueError(f'the compressed image cannot be decoded: {reason}') from error
    if pixels is None or pixels.shape[1::-1] != size:
        raise ValueError(f'the compressed image ({len(data)} bytes) cannot be decoded: '
                         'it is damaged')
    return pixels


def wrong_size(size: tuple[int, int], expected: tuple[int, int]) -> str:
    """Return the error message for an image whose size is not that of its CameraInfo."""
    return (f'the image is {size[0]} x {size[1]}, its CameraInfo is for {expected[0]} x '
            f'{expected[1]} (after region of interest and binning)')


def pixels_of(msg: Image, channel_type: str, channels: int, rows: int | None = None) -> np.ndarray:
    """
    Return the pixels (H, W, channels) of a message, a view of its data without the padding.

    ``rows`` is the number of rows in the data, if that is not the height. Raises ValueError if
    size, step and length of the data are inconsistent.
    """
    rows = msg.height if rows is None else rows
    dtype = np.dtype(channel_type).newbyteorder('>' if msg.is_bigendian else '<')
    row_bytes = msg.width * channels * dtype.itemsize
    if not row_bytes or not msg.height:
        raise ValueError(f'the image is empty: {msg.width} x {msg.height}')
    if msg.step < row_bytes:
        raise ValueError(f'step is {msg.step}, but a row of {msg.width} {msg.encoding} pixels '
                         f'takes {row_bytes} bytes')
    if len(msg.data) != rows * msg.step:
        raise ValueError(f'the data has {len(msg.data)} bytes, but height x step is '
                         f'{rows} x {msg.step}')
    data = np.frombuffer(msg.data, np.uint8).reshape(rows, msg.step)[:, :row_bytes]
    return np.ascontiguousarray(data).view(dtype).reshape(rows, msg.width, channels)


def _check_sides(msg: Image, encoding: str) -> None:
    """Check that the sides suit an encoding in which neighbouring pixels share colours."""
    if encoding in _HALF_COLOUR and (msg.width % 2 or msg.height % 2):
        raise ValueError(f'the sides of a {msg.encoding} image must be even, not {msg.width} x '
                         f'{msg.height}')
    if _CHANNELS.get(encoding) == 2 and msg.width % 2:
        raise ValueError(f'the width of a {msg.encoding} image must be even, not {msg.width}')
    if encoding.startswith('bayer') and min(msg.width, msg.height) < 3:
        raise ValueError(f'a {msg.encoding} image of {msg.width} x {msg.height} is too small')
