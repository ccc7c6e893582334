# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Measured depth as drivers send it: compressedDepth by PNG and RVL, organised clouds."""

from __future__ import annotations

import struct

import cv2
import numpy as np
from ros_helpers import header
from sensor_msgs.msg import CompressedImage, PointCloud2, PointField

# Of compressed_depth_image_transport with its default settings: quantisation 100, up to 10 m.
QUANTISATION_A, QUANTISATION_B = 100.0 * 101.0, 1.0 - 100.0 * 101.0 / 10.0


def encode_rvl(pixels: np.ndarray) -> bytes:
    """Return an image of uint16 as RVL, nibble by nibble as in Wilson's paper."""
    nibbles: list[int] = []

    def put(value: int) -> None:
        while True:
            value, low = value >> 3, value & 7
            nibbles.append(low | 8 if value else low)
            if not value:
                return
    values, at, previous = pixels.ravel().tolist(), 0, 0
    while at < len(values):
        begin = at
        while at < len(values) and values[at] == 0:
            at += 1
        put(at - begin)
        begin = at
        while at < len(values) and values[at]:
            at += 1
        put(at - begin)
        for value in values[begin:at]:
            change, previous = value - previous, value
            put(2 * change if change >= 0 else -2 * change - 1)
    nibbles += [0] * (-len(nibbles) % 8)
    return b''.join(struct.pack('<I', int(''.join(f'{n:x}' for n in nibbles[k:k + 8]), 16))
                    for k in range(0, len(nibbles), 8))


def compressed_depth_msg(depth_m: np.ndarray, encoding: str = '16UC1', kind: str = 'png',
                         stamp_s: float = 0.0, unit_m: float = 0.001) -> CompressedImage:
    """Return depth (H, W) as compressedDepth of an image with this encoding."""
    with np.errstate(all='ignore'):
        counts = (QUANTISATION_A / depth_m + QUANTISATION_B if encoding == '32FC1'
                  else depth_m / unit_m)
    counts = np.nan_to_num(counts.round(), posinf=0, neginf=0).astype(np.uint16)
    payload = (struct.pack('<II', *counts.shape[::-1]) + encode_rvl(counts) if kind == 'rvl'
               else cv2.imencode('.png', counts)[1].tobytes())
    return CompressedImage(
        header=header(stamp_s), format=f'{encoding}; compressedDepth {kind}',
        data=struct.pack('<iff', 0, QUANTISATION_A, QUANTISATION_B) + payload)


def cloud_msg(points_m: np.ndarray, stamp_s: float = 0.0, dtype: str = '<f4',
              padding: int = 4) -> PointCloud2:
    """Return points (H, W, 3) as an organised cloud whose points and rows end with other bytes."""
    dtype = np.dtype(dtype)
    kind = {4: PointField.FLOAT32, 8: PointField.FLOAT64}[dtype.itemsize]
    height, width, _ = points_m.shape
    raw = np.ascontiguousarray(points_m, dtype).view(np.uint8).reshape(height, width, -1)
    raw = np.pad(raw, ((0, 0), (0, 0), (0, padding)), constant_values=255)
    rows = np.pad(raw.reshape(height, -1), ((0, 0), (0, padding)), constant_values=255)
    return PointCloud2(
        header=header(stamp_s), height=height, width=width, is_bigendian=dtype.byteorder == '>',
        point_step=raw.shape[2], row_step=rows.shape[1], data=rows.tobytes(),
        fields=[PointField(name=name, offset=k * dtype.itemsize, datatype=kind, count=1)
                for k, name in enumerate('xyz')])
