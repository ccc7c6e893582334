# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Frames of a data folder, written; clouds in PLY files, read back."""

import json
from pathlib import Path

import cv2
import numpy as np


def write_frame(folder, depth_mm):
    folder.mkdir()
    about = {'fx': 131.0, 'fy': 131.0, 'cx': 79.5, 'cy': 59.5, 'width': 160, 'height': 120,
             'depth_unit_m': 0.001, 'invalid': 0}
    (folder / 'intrinsics.json').write_text(json.dumps(about))
    cv2.imwrite(str(folder / '7_depth.png'), depth_mm)
    cv2.imwrite(str(folder / '7_rgb.png'), np.full((120, 160, 3), (10, 20, 30), np.uint8))


TYPES = {'float': '<f4', 'uchar': 'u1', 'int': '<i4'}


def read_ply(path: Path) -> tuple[list[str], np.ndarray]:
    """Return the lines of the header, and the vertices."""
    head, _, body = path.read_bytes().partition(b'end_header\n')
    lines = head.decode().splitlines()
    return lines, np.frombuffer(body, [(name, TYPES[kind]) for word, kind, name in (
        line.split() for line in lines if line.startswith('property'))])
