# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The fields of ``~/planes`` in order, for planes and their enclosing rectangles."""

from __future__ import annotations

import numpy as np

from plane_detector.plane_fields import Column, Published, columns_of, wire_type
from plane_detector.planes.outline import Rectangles
from plane_detector.types import Planes

# Guaranteed for programs that read by position; later additions follow, in column order.
FIRST = ('x', 'y', 'z', 'normal_x', 'normal_y', 'normal_z', 'd', 'label', 'num_inliers', 'rms',
         'area', 'class', 'confidence', 'rect_x', 'rect_y', 'rect_z', 'rect_qx', 'rect_qy',
         'rect_qz', 'rect_qw', 'rect_width', 'rect_height', 'merged')


def _parts() -> list[tuple[Column, Published]]:
    """Return the published parts in order, each with the column that it is made from."""
    parts = [(row, part) for table in (Planes, Rectangles)
             for row in columns_of(table).values() for part in row.published]
    places = {name: place for place, name in enumerate(FIRST)}
    return sorted(parts, key=lambda of: places.get(of[1].names.split()[0], len(places)))


_PARTS = _parts()
PUBLISHED = tuple(part for _, part in _PARTS)
FORMATS = {name: wire_type(row) for row, part in _PARTS for name in part.names.split()}
PLANE_DTYPE = np.dtype(list(FORMATS.items()), align=True)
_TYPES = {'<f4': 'FLOAT32', '<u4': 'UINT32', 'u1': 'UINT8'}


def documented() -> str:
    """Return the fields as a Markdown table."""
    rows = [f'| {" ".join(f"`{name}`" for name in part.names.split())} '
            f'| {_TYPES[wire_type(row)]} | {part.unit} | {part.doc} |'.replace('|  |', '| |')
            for row, part in _PARTS]
    return '\n'.join(['| field | type | unit | meaning |', '|---|---|---|---|', *rows, ''])
