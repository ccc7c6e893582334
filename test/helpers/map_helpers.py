# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Planes of a map, made by hand."""

import numpy as np

from plane_detector.mapping.cells import Cells
from plane_detector.mapping.map_plane import CLASSES, MapPlane


def map_plane(label, kind, origin_m, axes, counts, corner=(0, 0), variance=1e-6, apart=()):
    """Return a flat plane, whose cells of 5 cm, from a corner on, were seen so many times."""
    counts = np.asarray(counts, np.uint8)
    return MapPlane(label, np.array(origin_m, float), axes, np.zeros(3), variance * np.eye(3),
                    Cells(corner, counts, counts.copy(), 0.05), 5, 0.0, 1.0, 1,
                    np.eye(CLASSES)[kind], frozenset(apart))
