# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The planes of a message of ``~/planes`` as JSON, for people and for other languages."""

from __future__ import annotations

import json

import numpy as np
from sensor_msgs.msg import PointCloud2

from plane_detector.planes.classification import PlaneClass
from plane_detector.ros.inputs.synchronizer import stamp_text
from plane_detector.ros.outputs.messages import read_cloud

_DIGITS = 4  # a tenth of a millimetre
# By name in JSON: fields of ~/planes.
_FIELDS = {'normal': ('normal_x', 'normal_y', 'normal_z'), 'centroid': ('x', 'y', 'z'),
           'd': ('d',), 'width': ('rect_width',), 'height': ('rect_height',), 'area': ('area',),
           'rms': ('rms',), 'confidence': ('confidence',)}
_LENGTHS = ('d', 'centroid', 'width', 'height', 'rms')


def planes_to_json(msg: PointCloud2, is_metric: bool = True) -> str:
    """
    Return stamp, frame, units and planes as one line of JSON, the largest plane first.

    Names are those of the fields of ``~/planes``; the class is its name. The unit of lengths is
    null while metres are not known. Of ``~/map/planes``, those that are part of another are left
    out.
    """
    length = 'm' if is_metric else None
    return json.dumps({
        'stamp': stamp_text(msg), 'frame_id': msg.header.frame_id,
        'units': {**dict.fromkeys(_LENGTHS, length), 'area': 'm^2' if is_metric else None,
                  'num_inliers': 'px'},
        'planes': _as_dicts(read_cloud(msg).ravel()) if msg.height else []})


def _as_dicts(table: np.ndarray) -> list[dict[str, object]]:
    """Return the rows of ``~/planes`` with plain values."""
    if 'subsumed_by' in table.dtype.names:
        table = table[table['subsumed_by'] == 0]
    column = {name: table[name].tolist() for name in table.dtype.names}
    rounded = {name: [round(value, _DIGITS) for value in column[name]]
               for names in _FIELDS.values() for name in names}
    return [{'label': column['label'][k], 'class': PlaneClass(column['class'][k]).readable,
             **{name: [rounded[field][k] for field in fields] if len(fields) > 1
                else rounded[fields[0]][k] for name, fields in _FIELDS.items()},
             'num_inliers': column['num_inliers'][k]} for k in range(len(table))]
