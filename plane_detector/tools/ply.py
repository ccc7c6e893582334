# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Labelled clouds as PLY files, which MeshLab, CloudCompare, Open3D and Blender open."""

from __future__ import annotations

from pathlib import Path

import numpy as np

_VERTEX = np.dtype([('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('red', 'u1'), ('green', 'u1'),
                    ('blue', 'u1'), ('label', '<i4')])
_PLY_TYPES = {'f4': 'float', 'u1': 'uchar', 'i4': 'int'}


def write_ply(path: Path, points_m: np.ndarray, rgb: np.ndarray, labels: np.ndarray,
              in_metres: bool = True) -> int:
    """
    Write the points (..., 3) with finite coordinates, little-endian binary; return their number.

    Each has a colour, uint8, and the label of a plane, 0 for none. The file states whether the
    unit is the metre or unknown.
    """
    valid = np.isfinite(points_m).all(axis=-1)
    vertices = np.empty(np.count_nonzero(valid), _VERTEX)
    for axis, name in enumerate(('x', 'y', 'z')):
        vertices[name] = points_m[valid, axis]
    for channel, name in enumerate(('red', 'green', 'blue')):
        vertices[name] = rgb[valid, channel]
    vertices['label'] = labels[valid]
    header = _header(len(vertices), in_metres)
    with open(path, 'wb') as file:
        file.write(header.encode('ascii'))
        file.write(vertices.tobytes())
    return len(vertices)


def _header(count: int, in_metres: bool) -> str:
    """Return the header of the file."""
    properties = [f'property {_PLY_TYPES[kind.str[1:]]} {name}'
                  for name, (kind, _) in _VERTEX.fields.items()]
    return '\n'.join(['ply', 'format binary_little_endian 1.0',
                      f'comment {"metres" if in_metres else "unit of length not known"}',
                      'comment camera frame: x right, y down, z forward; label 0: no plane',
                      f'element vertex {count}', *properties, 'end_header', ''])
