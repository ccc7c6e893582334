# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The planes of a message of ``~/planes`` as JSON, for people and for other languages."""

from __future__ import annotations

import json

import numpy as np
from sensor_msgs.msg import PointCloud2

from plane_detector.plane_fields import POWERS, PlaneClass
from plane_detector.planes.plane_table import PUBLISHED
from plane_detector.ros.inputs.synchronizer import stamp_text
from plane_detector.ros.outputs.messages import read_cloud

# By name in JSON; the identifying fields first.
_PARTS = {part.json: part for part in sorted(
    PUBLISHED, key=lambda part: part.json not in ('label', 'class')) if part.json}


def planes_to_json(msg: PointCloud2, is_metric: bool = True) -> str:
    """
    Return stamp, frame, units and planes as one line of JSON, the largest plane first.

    Names are those of the fields of ``~/planes``; the class is its name. The unit of lengths is
    null while metres are unknown. Rows of ``~/map/planes`` that are part of another plane are
    omitted.
    """
    return json.dumps({
        'stamp': stamp_text(msg), 'frame_id': msg.header.frame_id,
        'units': {name: part.unit if is_metric or not POWERS[part.unit] else None
                  for name, part in _PARTS.items() if part.unit},
        'planes': _as_dicts(read_cloud(msg).ravel()) if msg.height else []})


def _as_dicts(table: np.ndarray) -> list[dict[str, object]]:
    """Return the rows of ``~/planes`` with plain values."""
    if 'subsumed_by' in table.dtype.names:
        table = table[table['subsumed_by'] == 0]
    columns = {}
    for name, part in _PARTS.items():
        if not set(fields := part.names.split()) <= set(table.dtype.names):
            continue  # from a bag that an earlier version wrote
        values = [_plain(field, table[field].tolist(), part.digits) for field in fields]
        columns[name] = list(zip(*values, strict=True)) if len(fields) > 1 else values[0]
    return [dict(zip(columns, row, strict=True))
            for row in zip(*columns.values(), strict=True)]


def _plain(field: str, values: list, digits: int) -> list:
    """Return the values of a field, rounded; for a class its name."""
    if field == 'class':
        return [PlaneClass(value).readable for value in values]
    return [round(value, digits) for value in values]
