# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Small files that declare or cost much more than their content."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np

PNG_BEGIN = b'\x89PNG\r\n\x1a\n'


def png_chunk(kind: bytes, content: bytes) -> bytes:
    """Return a chunk of a PNG file."""
    return (struct.pack('>I', len(content)) + kind + content
            + struct.pack('>I', zlib.crc32(kind + content)))


def png_bomb(width: int, height: int) -> bytes:
    """Return a whole PNG file of one bit per pixel, all black."""
    packer, rows, left = zlib.compressobj(9), [], height * ((width + 7) // 8 + 1)
    while left > 0:
        rows.append(packer.compress(bytes(min(left, 1 << 20))))
        left -= 1 << 20
    header = struct.pack('>IIBBBBB', width, height, 1, 0, 0, 0, 0)
    return (PNG_BEGIN + png_chunk(b'IHDR', header)
            + png_chunk(b'IDAT', b''.join(rows) + packer.flush()) + png_chunk(b'IEND', b''))


def jpeg_bomb(width: int, height: int) -> bytes:
    """Return a JPEG file of 64 x 64 whose header declares another size."""
    small = cv2.imencode('.jpg', np.zeros((64, 64), np.uint8))[1].tobytes()
    frame = small.index(b'\xff\xc0')
    return small[:frame + 5] + struct.pack('>HH', height, width) + small[frame + 9:]


def jpeg_of_many_scans(width: int, height: int, scans: int) -> bytes:
    """Return a progressive JPEG file whose last scan is there so many times."""
    flags = [cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_QUALITY, 30]
    plain = cv2.imencode('.jpg', np.zeros((height, width, 3), np.uint8), flags)[1].tobytes()
    last = plain.rindex(b'\xff\xda')
    return plain[:last] + scans * plain[last:-2] + plain[-2:]
