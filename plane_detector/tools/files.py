# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
What demo and replay write: panels of figures, rows of tables, and labelled clouds as PLY files,
which MeshLab, CloudCompare, Open3D and Blender open.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from plane_detector import drawing
from plane_detector.types import PlaneClass

_VERTEX = np.dtype([('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('red', 'u1'), ('green', 'u1'),
                    ('blue', 'u1'), ('label', '<i4')])
_PLY_TYPES = {'f4': 'float', 'u1': 'uchar', 'i4': 'int'}


def depth_panel(title: str, depth_m: np.ndarray, unit: str) -> tuple[str, np.ndarray]:
    """Return the panel of a depth image for :func:`~plane_detector.drawing.figure`."""
    near, far = drawing.depth_range(depth_m)
    return (f'{title}, red {near:.1f} {unit} to blue {far:.1f} {unit}',
            drawing.colour_depth(depth_m))


def csv_head(dtype: np.dtype) -> list[str]:
    """Return the names of the fields that :func:`csv_row` returns."""
    return [*dtype.names, *(['class_name'] if 'class' in dtype.names else [])]


def csv_row(fields: np.void) -> list[object]:
    """Return the fields of a plane or a shape, with six digits, and the class name of a plane."""
    values = [f'{value:.6g}' if isinstance(value, np.floating) else value for value in fields]
    named = [PlaneClass(fields['class']).readable] if 'class' in fields.dtype.names else []
    return [*values, *named]


def write_ply(path: Path, points_m: np.ndarray, rgb: np.ndarray, labels: np.ndarray,
              in_metres: bool = True) -> int:
    """
    Write the points (..., 3) with finite coordinates, little-endian binary; return their number.

    Each point has a colour, uint8, and the label of a plane, 0 for none. The file states whether
    the unit is the metre or unknown.
    """
    valid = np.isfinite(points_m).all(axis=-1)
    vertices = np.empty(np.count_nonzero(valid), _VERTEX)
    for k, (axis, channel) in enumerate((('x', 'red'), ('y', 'green'), ('z', 'blue'))):
        vertices[axis], vertices[channel] = points_m[valid, k], rgb[valid, k]
    vertices['label'] = labels[valid]
    header = ['ply', 'format binary_little_endian 1.0',
              f'comment {"metres" if in_metres else "unit of length not known"}',
              'comment camera frame: x right, y down, z forward; label 0: no plane',
              f'element vertex {len(vertices)}',
              *(f'property {_PLY_TYPES[kind.str[1:]]} {name}'
                for name, (kind, _) in _VERTEX.fields.items()), 'end_header', '']
    path.write_bytes('\n'.join(header).encode('ascii') + vertices.tobytes())
    return len(vertices)
