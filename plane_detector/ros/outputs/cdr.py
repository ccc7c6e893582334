# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Messages of many small messages, markers and poses, written in their serialised form.

That is CDR (Common Data Representation, OMG DDSI-RTPS 10.2), which a publisher sends. rclpy
converts a message field by field, and every corner of an outline is a message: for 20 planes that
took 4 ms of a frame, in which no other thread could run Python.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from rclpy.duration import Duration
from std_msgs.msg import Header

NO_POINTS = np.zeros((0, 3))
UNTURNED = (0.0, 0.0, 0.0, 1.0)
_ORIGIN = (0.0, 0.0, 0.0)


class MarkerValues(NamedTuple):
    """
    The fields of a visualization_msgs/Marker that the node sets.

    Attributes
    ----------
    namespace : str
    label : int
        The id.
    kind, action : int
        Constants of that message.
    rgba : (4,) float
    scale_m : (3,) float
    points_m : (N, 3) float64
        Relative to the pose.
    position_m : (3,) float
    orientation : (4,) float
        Quaternion x y z w.
    text : str

    """

    namespace: str
    label: int
    kind: int
    action: int
    rgba: tuple[float, ...] = (0.0,) * 4
    scale_m: tuple[float, ...] = _ORIGIN
    points_m: np.ndarray = NO_POINTS
    position_m: tuple[float, ...] = _ORIGIN
    orientation: tuple[float, ...] = UNTURNED
    text: str = ''


# In CDR every number begins at a multiple of its size, counted from the end of these four bytes.
_LITTLE_ENDIAN = b'\0\1\0\0'
_IDENTITY = struct.Struct('<3i')  # id, type, action
# Pose, scale, colour, lifetime, frame_locked, number of points.
_SHAPE = struct.Struct('<10d4fiI?3xI')
_TEXT_LENGTH = struct.Struct('<I')
_EMPTY = struct.pack('<Is3x', 1, b'\0')  # a string
# colors, texture_resource, texture (stamp, frame_id, format, data), uv_coordinates.
_NO_TEXTURE = bytes(4) + _EMPTY + bytes(8) + _EMPTY + _EMPTY + bytes(4) + bytes(4)
# mesh_resource, mesh_file (filename, data), mesh_use_embedded_materials.
_NO_MESH = _EMPTY + _EMPTY + bytes(4) + bytes(1)


def serialised_markers(header: Header, markers: Iterable[MarkerValues],
                       lifetime_s: float) -> bytes:
    """
    Return a serialised visualization_msgs/MarkerArray, as a publisher takes it.

    Parameters
    ----------
    header : std_msgs.msg.Header
        Of all markers.
    markers : iterable of MarkerValues
    lifetime_s : float
        Seconds after which a marker disappears; 0: never.

    """
    lifetime = Duration(seconds=lifetime_s).to_msg()
    start = _header(header)
    data, count = bytearray(4), 0
    for marker in markers:
        data += bytes(-len(data) % 4) + start + _string(marker.namespace)
        data += _IDENTITY.pack(marker.label, marker.kind, marker.action)
        data += bytes(-len(data) % 8) + _SHAPE.pack(
            *marker.position_m, *marker.orientation, *marker.scale_m, *marker.rgba,
            lifetime.sec, lifetime.nanosec, False, len(marker.points_m))
        if len(marker.points_m):
            data += bytes(-len(data) % 8) + marker.points_m.astype('<f8', copy=False).tobytes()
        data += _NO_TEXTURE + _string(marker.text) + _NO_MESH
        count += 1
    data[:4] = struct.pack('<I', count)
    return _LITTLE_ENDIAN + bytes(data)


def serialised_poses(header: Header, positions_m: np.ndarray, orientations: np.ndarray) -> bytes:
    """
    Return a serialised geometry_msgs/PoseArray.

    Parameters
    ----------
    header : std_msgs.msg.Header
    positions_m : (N, 3) float64
    orientations : (N, 4) float64
        Quaternions x y z w.

    """
    data = _header(header) + struct.pack('<I', len(positions_m))
    if len(positions_m):
        data += bytes(-len(data) % 8)
        data += np.hstack([positions_m, orientations]).astype('<f8', copy=False).tobytes()
    return _LITTLE_ENDIAN + data


def _header(header: Header) -> bytes:
    stamp = struct.pack('<iI', header.stamp.sec, header.stamp.nanosec)
    return stamp + _string(header.frame_id)


@lru_cache(maxsize=256)
def _string(text: str) -> bytes:
    """Return length and characters, and zeros up to the next multiple of 4."""
    characters = text.encode() + b'\0'
    return _TEXT_LENGTH.pack(len(characters)) + characters + bytes(-len(characters) % 4)
