# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Reading of a PointCloud2 as an array, according to its fields."""

from __future__ import annotations

import numpy as np
from sensor_msgs.msg import PointCloud2, PointField

_TYPES = {PointField.INT8: 'i1', PointField.UINT8: 'u1', PointField.INT16: 'i2',
          PointField.UINT16: 'u2', PointField.INT32: 'i4', PointField.UINT32: 'u4',
          PointField.FLOAT32: 'f4', PointField.FLOAT64: 'f8'}


def read_cloud(msg: PointCloud2) -> np.ndarray:
    """Return the points, a structured array (height, width) that shares the message's memory."""
    order = '>' if msg.is_bigendian else '<'
    dtype = np.dtype({'names': [field.name for field in msg.fields],
                      'formats': [order + _TYPES[field.datatype] for field in msg.fields],
                      'offsets': [field.offset for field in msg.fields],
                      'itemsize': msg.point_step})
    rows = np.frombuffer(msg.data, np.uint8).reshape(msg.height, msg.row_step)
    return rows[:, :msg.width * msg.point_step].view(dtype)
