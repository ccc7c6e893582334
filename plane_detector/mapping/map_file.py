# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The file of a map: JSON that other programs can read too.

``planes`` have ``normal``, ``d``, their ``covariance`` and ``polygons`` in ``frame``, where the
last pose saw them, and the plane as it is kept: heights over a frame of its own, and run lengths
of the bitmap of its cells, row by row, beginning with those that are not seen.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.mapping.cells import MOST_LOOKS, Cells
from plane_detector.mapping.map_plane import CLASSES, MapPlane, as_planes, polygons_of

VERSION = 1


@dataclass(frozen=True)
class SavedMap:
    """What a file keeps of a map."""

    planes: tuple[MapPlane, ...]
    transform: RigidTransform  # from the frame of the poses to that of the map
    frame_id: str  # of the poses
    stamp_s: float


def write_map(path: Path, saved: SavedMap) -> None:
    """Write a map; the file is replaced when the new one is whole. OSError if that fails."""
    text = json.dumps({
        'version': VERSION, 'frame': saved.frame_id, 'stamp': saved.stamp_s,
        'correction': {'translation': saved.transform.translation_m.tolist(),
                       'quaternion': saved.transform.quaternion.tolist()},
        'planes': _rows(saved)}, separators=(',', ':'))
    draft = path.with_name(f'.{path.name}.part')
    try:
        with open(draft, 'w', encoding='utf-8') as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.replace(draft, path)
    except OSError as error:
        draft.unlink(missing_ok=True)
        raise OSError(f'the map cannot be written to {path}: {error}') from error


def read_map(path: Path, frame_id: str = '') -> SavedMap:
    """
    Read a map, of this frame if one is named.

    Raises
    ------
    OSError
        The file cannot be read.
    ValueError
        It is no whole map, or of another frame or a later version.

    """
    try:
        content = json.loads(path.read_text(encoding='utf-8'))
    except FileNotFoundError as error:
        raise FileNotFoundError(f'there is no file {path}: ~/map/save and replay --map write one'
                                ) from error
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f'{path} is not a whole map of planes: {error}') from error
    version = content.get('version') if isinstance(content, dict) else None
    if not isinstance(version, int):
        raise ValueError(f'{path} is not a map of planes: it has no version')
    if version > VERSION:
        raise ValueError(f'{path} is a map of version {version}, this program reads up to '
                         f'{VERSION}: update plane_detector')
    try:
        found = SavedMap(
            tuple(map(_plane, content['planes'])),
            RigidTransform.from_quaternion(content['correction']['quaternion'],
                                           content['correction']['translation']),
            str(content['frame']), float(content['stamp']))
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise ValueError(f'{path} is a damaged map of planes: {type(error).__name__}: {error}'
                         ) from error
    if frame_id and found.frame_id != frame_id:
        raise ValueError(f'{path} is a map in the frame {found.frame_id}, not in {frame_id}: set '
                         f'target_frame to {found.frame_id}, or load another file')
    return found


def _rows(saved: SavedMap) -> list[dict[str, Any]]:
    planes = as_planes(saved.planes).moved(saved.transform.inverse())
    rows = []
    for k, plane in enumerate(saved.planes):
        rows.append({
            'label': plane.label, 'class': plane.plane_class.readable,
            'normal': _rounded(planes.normals[k], 7), 'd': round(float(planes.offsets_m[k]), 6),
            'covariance': [float(f'{value:.5g}') for value in planes.covariances[k].ravel()],
            'area': round(plane.cells.area_m2, 4),
            'polygons': [{'hole': polygon.is_hole, 'corners': _rounded(
                saved.transform.inverse().points(polygon.corners_m), 3)}
                for polygon in polygons_of(plane)],
            'views': plane.views, 'first_seen': plane.first_seen_s,
            'last_seen': plane.last_seen_s, 'first_image': plane.first_image,
            'votes': _rounded(plane.votes, 3), 'apart': sorted(plane.apart),
            'kept': {'origin': plane.origin_m.tolist(), 'axes': plane.axes.tolist(),
                     'coefficients': plane.coefficients.tolist(),
                     'covariance': plane.covariance.tolist(),
                     'cell': plane.cells.size_m, 'low': plane.cells.low,
                     'columns': plane.cells.hits.shape[1], 'runs': _runs(plane.cells.seen)}})
    return rows


def _rounded(values: np.ndarray, digits: int) -> list:
    return np.round(values, digits).tolist()


def _runs(seen: np.ndarray) -> list[int]:
    """Return the lengths of runs of equal cells; the first one, which may be 0, is not seen."""
    flat = np.concatenate([[False], seen.ravel()])
    ends = np.append(np.flatnonzero(flat[1:] != flat[:-1]), seen.size)
    return [int(ends[0]), *(int(after - before) for before, after in pairwise(ends))]


def _plane(row: dict[str, Any]) -> MapPlane:
    kept = row['kept']
    runs = np.array(kept['runs'], int)
    seen = np.repeat(np.arange(len(runs)) % 2, runs).astype(np.uint8).reshape(-1, kept['columns'])
    counts = seen * np.uint8(MOST_LOOKS // 2)
    arrays = {name: np.array(values, float).reshape(shape) for name, values, shape in (
        ('origin_m', kept['origin'], 3), ('axes', kept['axes'], (3, 3)),
        ('coefficients', kept['coefficients'], 3), ('covariance', kept['covariance'], (3, 3)),
        ('votes', row['votes'], CLASSES))}
    if not all(np.isfinite(values).all() for values in arrays.values()):
        raise ValueError('a number is not finite')
    return MapPlane(
        label=int(row['label']), cells=Cells(tuple(map(int, kept['low'])), counts, counts.copy(),
                                             float(kept['cell'])),
        views=int(row['views']), first_seen_s=float(row['first_seen']),
        last_seen_s=float(row['last_seen']), first_image=int(row['first_image']),
        apart=frozenset(map(int, row['apart'])), **arrays)
