# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Table of the planes of a scene by class, with the angles between them."""

from __future__ import annotations

import numpy as np

from plane_detector.drawing import PALETTE, label_colours
from plane_detector.planes.classification import PlaneClass

NAMES = {PlaneClass.FLOOR: 'floor', PlaneClass.CEILING: 'ceiling', PlaneClass.WALL: 'wall',
         PlaneClass.OTHER_HORIZONTAL: 'level', PlaneClass.OTHER: 'other',
         PlaneClass.UNKNOWN: 'unknown', PlaneClass.RAMP: 'ramp', PlaneClass.STEP: 'step'}
COLOURS = {PlaneClass.FLOOR: ('green', PALETTE[1]), PlaneClass.CEILING: ('yellow', PALETTE[3]),
           PlaneClass.WALL: ('blue', PALETTE[2]), PlaneClass.OTHER: ('violet', PALETTE[4]),
           PlaneClass.OTHER_HORIZONTAL: ('orange', PALETTE[6]),
           PlaneClass.RAMP: ('cyan', PALETTE[5]), PlaneClass.STEP: ('orange', PALETTE[6])}
_ROWS_SHOWN = 14
_COLUMNS_SHOWN = 6


def class_colours(planes: np.ndarray) -> np.ndarray:
    """
    Return a colour for each label: that of its class, or its own if the class is unknown.

    Parameters
    ----------
    planes : (N,) structured
        Fields label and class of ``~/planes``.

    Returns
    -------
    (L, 3) uint8
        RGB of the labels from 0 to the largest.

    """
    colours = label_colours(np.arange(planes['label'].max(initial=0) + 1))
    for plane in planes:
        if plane['class'] in COLOURS:
            colours[plane['label']] = COLOURS[plane['class']][1]
    return colours


def legend(planes: np.ndarray) -> str:
    """Return the classes in the scene with their colours; empty if none is known."""
    there = [kind for kind in NAMES if kind in COLOURS and (planes['class'] == kind).any()]
    return ', '.join(f'{NAMES[kind]} {COLOURS[kind][0]}' for kind in there)


def by_class(planes: np.ndarray) -> np.ndarray:
    """Return the planes in the order floor, ceiling, walls, others, largest first in each."""
    rank = {kind: place for place, kind in enumerate(NAMES)}
    order = np.lexsort((-planes['num_inliers'].astype(np.int64),
                        [rank[PlaneClass(kind)] for kind in planes['class']]))
    return planes[order]


def angles_deg(planes: np.ndarray) -> np.ndarray:
    """Return the angles (N, N) between the planes, 0 to 90 degrees."""
    normals = np.column_stack([planes[f'normal_{axis}'] for axis in 'xyz']).astype(np.float64)
    return np.degrees(np.arccos(np.clip(np.abs(normals @ normals.T), 0, 1)))


def scene_table(planes: np.ndarray, unit: str) -> str:
    """
    Return the planes as a table, class by class, with the angles between them.

    Parameters
    ----------
    planes : (N,) structured
        Fields of ``~/planes``.
    unit : str
        Unit of lengths.

    """
    if not len(planes):
        return '  no plane found'
    ordered = by_class(planes)
    angle = angles_deg(ordered)
    columns = ordered[:_COLUMNS_SHOWN]
    lines = ['  ' + ''.join(f'{title:>10}' for title in (
        'class', 'label', f'd [{unit}]', f'area [{unit}2]', 'pixels', f'rms [{unit}]'))
        + '    angle to' + ''.join(f'{label:>5}' for label in columns['label'])]
    for k, plane in enumerate(ordered[:_ROWS_SHOWN]):
        between = ''.join(f'{"-" if k == j else f"{angle[k, j]:.0f}":>5}'
                          for j in range(len(columns)))
        lines.append(f'  {NAMES[PlaneClass(plane["class"])]:>10}{plane["label"]:10d}'
                     f'{plane["d"]:10.2f}{plane["area"]:10.2f}{plane["num_inliers"]:10d}'
                     f'{plane["rms"]:10.3f}            {between}')
    if len(ordered) > _ROWS_SHOWN:
        lines.append(f'  {"...":>10}  and {len(ordered) - _ROWS_SHOWN} more, in the .csv')
    if not legend(planes):
        lines.append('  (the direction of gravity is not known: no floor, no walls)')
    return '\n'.join(lines)
