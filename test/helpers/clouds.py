# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Clouds in PLY files, read back."""

from pathlib import Path

import numpy as np

TYPES = {'float': '<f4', 'uchar': 'u1', 'int': '<i4'}


def read_ply(path: Path) -> tuple[list[str], np.ndarray]:
    """Return the lines of the header, and the vertices."""
    head, _, body = path.read_bytes().partition(b'end_header\n')
    lines = head.decode().splitlines()
    return lines, np.frombuffer(body, [(name, TYPES[kind]) for word, kind, name in (
        line.split() for line in lines if line.startswith('property'))])
