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
_LENGTHS = ('d', 'centroid', 'width', 'height', 'rms')


def planes_to_json(msg: PointCloud2, is_metric: bool = True) -> str:
    """
    Return stamp, frame, units and planes as one line of JSON, the largest plane first.

    Names are those of the fields of ``~/planes``; the class is its name. The unit of lengths is
    null while metres are not known.
    """
    length = 'm' if is_metric else None
    return json.dumps({
        'stamp': stamp_text(msg), 'frame_id': msg.header.frame_id,
        'units': {**dict.fromkeys(_LENGTHS, length), 'area': 'm^2' if is_metric else None,
                  'num_inliers': 'px'},
        'planes': [_as_dict(row) for row in (read_cloud(msg).ravel() if msg.height else ())]})


def _as_dict(row: np.void) -> dict[str, object]:
    """Return a row of ``~/planes`` with plain values."""
    vectors = {'normal': ('normal_x', 'normal_y', 'normal_z'), 'centroid': ('x', 'y', 'z')}
    numbers = {'d': 'd', 'width': 'rect_width', 'height': 'rect_height', 'area': 'area',
               'rms': 'rms', 'confidence': 'confidence'}
    return {'label': int(row['label']), 'class': PlaneClass(row['class']).readable,
            **{name: [_rounded(row[field]) for field in fields]
               for name, fields in vectors.items()},
            **{name: _rounded(row[field]) for name, field in numbers.items()},
            'num_inliers': int(row['num_inliers'])}


def _rounded(value: float) -> float:
    return round(float(value), _DIGITS)
