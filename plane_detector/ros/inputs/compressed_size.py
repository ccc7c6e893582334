# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Size of a compressed image from its header, before anything is decoded.

A file of a few hundred bytes may declare an image of gigabytes. The formats are those of PNG
(ISO/IEC 15948) and JPEG (ITU-T T.81, annex B).
"""

from __future__ import annotations

import struct

_PNG_BEGIN = b'\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR'
_PNG_SIGNATURE_BYTES = 8
_PNG_CHUNK_BYTES = 12  # length, type and checksum of a chunk
_JPEG_BEGIN = b'\xff\xd8\xff'
_START_OF_SCAN = b'\xff\xda'
# Markers of a frame header: C0 to CF, except tables and reserved markers.
_FRAME_MARKERS = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_NO_SEGMENT = {0x01, *range(0xD0, 0xD9)}
MOST_SCANS = 100
"""Of a JPEG; encoders write 10 to 20, and each requires a pass over the whole image."""


def compressed_size(data: bytes) -> tuple[int, int]:
    """
    Return width and height from the header of a JPEG or PNG file.

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
    raise ValueError('it is a PNG file that breaks off')


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
