# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The file of a map: JSON that other programs can read too.

``planes`` have ``normal``, ``d``, their ``covariance`` and ``polygons`` in ``frame``, according to
the last pose, and the plane as stored: heights over its own frame, and run lengths of the bitmap
of its cells, row by row, starting with empty cells.
"""

from __future__ import annotations

import json
import math
import os
import reprlib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.mapping.cells import MOST_CELLS, MOST_CELLS_IN_ALL, MOST_LOOKS, Cells
from plane_detector.mapping.map_plane import CLASSES, MapPlane, polygons_of
from plane_detector.types import Planes

VERSION = 1
MOST_PLANES = 2000
"""Largest number of planes of a map, to limit its memory."""
# derived: reading a file of this size takes at most 200 MB: 32 bytes per number, 184 per object; a
# map of 2000 planes with outlines of 60 corners takes a third of each.
_MOST_BYTES, _MOST_VALUES, _MOST_OBJECTS = 32_000_000, 2_000_000, 500_000
# derived: the id of a marker is an int32, and half of its range is left for new planes.
_MOST_LABEL = 2**30
# chosen: coordinates of UTM fit.
_MOST_M = 1e7
# derived: heights are over a frame whose normal is within 30 degrees of the plane's.
_MOST_SLOPE = 1.0
# chosen: variances of heights, m^2, and of slopes: a hundredth of a micrometre to a kilometre.
_LEAST_VARIANCE, _MOST_VARIANCE = 1e-16, 1e6
# chosen: of the correlations; their inverse still has four digits.
_LEAST_EIGENVALUE = 1e-12
_MOST_COUNT = 2**31 - 1
_MOST_TIME_S = 1e11
_CELL_M = 0.001, 10.0
# Tolerance of a rotation matrix for rounding.
_ROUNDING = 1e-4


@dataclass(frozen=True)
class SavedMap:
    """The contents of the file of a map."""

    planes: tuple[MapPlane, ...]
    transform: RigidTransform  # from the frame of the poses to that of the map
    frame_id: str  # of the poses
    stamp_s: float


def write_map(path: Path, saved: SavedMap, shown: Planes) -> None:
    """
    Write a map; the file is replaced when the new one is complete.

    Parameters
    ----------
    path : Path
    saved : SavedMap
    shown : Planes
        Its planes in the frame of the poses, as published.

    Raises
    ------
    OSError
        The file cannot be written.
    ValueError
        It would be too large to be read.

    """
    data = json.dumps({
        'version': VERSION, 'frame': saved.frame_id, 'stamp': _or_null(saved.stamp_s),
        'correction': {'translation': saved.transform.translation_m.tolist(),
                       'quaternion': saved.transform.quaternion.tolist()},
        'planes': _rows(saved, shown)}, separators=(',', ':'), allow_nan=False).encode()
    _check_size(data, 'the map')
    draft = path.with_name(f'.{path.name}.part')
    try:
        with open(draft, 'wb') as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(draft, path)
    except OSError as error:
        draft.unlink(missing_ok=True)
        raise OSError(f'the map cannot be written to {path}: {error}') from error


def read_map(path: Path, frame_id: str = '') -> SavedMap:
    """
    Read a map; if a frame is named, it must be in that frame.

    Whatever the file contains: every value is checked before it is used.

    Raises
    ------
    OSError
        The file cannot be read.
    ValueError
        The map is incomplete, in another frame, or of a later version. The message names the
        field.

    """
    if not path.exists():
        raise FileNotFoundError(f'there is no file {path}: ~/map/save and replay --map write one')
    if not path.is_file():
        raise ValueError(f'{path} is not a file')
    with open(path, 'rb') as file:
        data = file.read(_MOST_BYTES + 1)
    _check_size(data, str(path))
    try:
        content = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise ValueError(f'{path} is not a whole map of planes: {error}') from error
    version = content.get('version') if isinstance(content, dict) else None
    if not isinstance(version, int):
        raise ValueError(f'{path} is not a map of planes: it has no version')
    if version > VERSION:
        raise ValueError(f'{path} is a map of version {_short(version)}, this program reads up to '
                         f'{VERSION}: update plane_detector')
    try:
        found = _saved_map(_Fields(content, ''))
    except ValueError as error:
        raise ValueError(f'{path} is a damaged map of planes: {error}') from error
    if frame_id and found.frame_id != frame_id:
        raise ValueError(f'{path} is a map in the frame {_short(found.frame_id)}, not in '
                         f'{frame_id}: set target_frame to that, or load another file')
    return found


def _check_size(data: bytes, name: str) -> None:
    for count, most, what in (
            (len(data), _MOST_BYTES, 'bytes'), (data.count(b','), _MOST_VALUES, 'values'),
            (data.count(b'[') + data.count(b'{'), _MOST_OBJECTS, 'lists and objects')):
        if count > most:
            raise ValueError(f'{name} is too large: it has more than {most} {what}')


def _rows(saved: SavedMap, shown: Planes) -> list[dict[str, Any]]:
    rows, labels = [], {plane.label for plane in saved.planes}
    for k, plane in enumerate(saved.planes):
        rows.append({
            'label': plane.label, 'class': plane.plane_class.readable,
            'normal': _rounded(shown.normals[k], 7), 'd': round(float(shown.offsets_m[k]), 6),
            'covariance': [float(f'{value:.5g}') for value in shown.covariances[k].ravel()],
            'area': round(plane.cells.area_m2, 4),
            'polygons': [{'hole': polygon.is_hole, 'corners': _rounded(
                saved.transform.inverse().points(polygon.corners_m), 3)}
                for polygon in polygons_of(plane)],
            'views': plane.views, 'first_seen': _or_null(plane.first_seen_s),
            'last_seen': _or_null(plane.last_seen_s), 'votes': _rounded(plane.votes, 3),
            'apart': sorted(plane.apart & labels),
            'kept': {'origin': plane.origin_m.tolist(), 'axes': plane.axes.tolist(),
                     'coefficients': plane.coefficients.tolist(),
                     'covariance': plane.covariance.tolist(),
                     'cell': plane.cells.size_m, 'low': plane.cells.low,
                     'columns': plane.cells.hits.shape[1], 'runs': _runs(plane.cells.seen)}})
    return rows


def _rounded(values: np.ndarray, digits: int) -> list:
    return np.round(values, digits).tolist()


def _or_null(time_s: float) -> float | None:
    return None if math.isnan(time_s) else time_s


def _runs(seen: np.ndarray) -> list[int]:
    """Return the lengths of runs of equal cells; the first run, which may be 0, is empty cells."""
    flat = np.concatenate([[False], seen.ravel()])
    ends = np.append(np.flatnonzero(flat[1:] != flat[:-1]), seen.size)
    return [int(ends[0]), *(int(after - before) for before, after in pairwise(ends))]


class _Fields:
    """An object of the file; a ValueError names the invalid field."""

    def __init__(self, content: object, name: str):
        if not isinstance(content, dict):
            raise ValueError(f'{name} is {_short(content)}, not an object')
        self._content, self._name = content, name

    def name_of(self, field: str) -> str:
        """Return the name of a field in the file."""
        return f'{self._name}.{field}' if self._name else field

    def within(self, field: str) -> _Fields:
        """Return an object."""
        return _Fields(self._value(field), self.name_of(field))

    def objects(self, field: str, most: int) -> list[_Fields]:
        """Return a list of objects."""
        return [_Fields(one, f'{self.name_of(field)}[{k}]')
                for k, one in enumerate(self._list(field, most))]

    def text(self, field: str) -> str:
        """Return a text, which is not empty."""
        value = self._value(field)
        if not isinstance(value, str) or not value:
            raise self._not(field, value, 'a text')
        return value

    def number(self, field: str, least: float, most: float) -> float:
        """Return a finite number."""
        return float(self._checked(field, self._value(field), least, most, (int, float)))

    def whole(self, field: str, least: int, most: int) -> int:
        """Return a whole number."""
        return self._checked(field, self._value(field), least, most, (int,))

    def wholes(self, field: str, least: int, most: int, count: int) -> list[int]:
        """Return a list of whole numbers, limited in length."""
        return [self._checked(field, value, least, most, (int,))
                for value in self._list(field, count)]

    def time_s(self, field: str) -> float:
        """Return a time; NaN for null, which means unknown."""
        if self._value(field) is None:
            return math.nan
        return self.number(field, -_MOST_TIME_S, _MOST_TIME_S)

    def array(self, field: str, shape: Sequence[int], least: float, most: float) -> np.ndarray:
        """Return an array of finite numbers."""
        values = [self._value(field)]
        for size in shape:
            if not all(isinstance(one, list) and len(one) == size for one in values):
                raise self._not(field, self._value(field),
                                f'{" x ".join(map(str, shape))} numbers')
            values = [value for one in values for value in one]
        return np.array([self._checked(field, value, least, most, (int, float))
                         for value in values], float).reshape(shape)

    def _value(self, field: str) -> Any:
        if field not in self._content:
            raise ValueError(f'{self.name_of(field)} is missing')
        return self._content[field]

    def _list(self, field: str, most: int) -> list:
        value = self._value(field)
        if not isinstance(value, list) or len(value) > most:
            raise self._not(field, value, f'a list of at most {most}')
        return value

    def _checked(self, field: str, value: Any, least: float, most: float,
                 kinds: tuple[type, ...]) -> Any:
        # In Python, true is a number; NaN is outside any limits.
        if type(value) not in kinds or not least <= value <= most:
            kind = 'number' if float in kinds else 'whole number'
            raise self._not(field, value, f'a {kind} from {least:g} to {most:g}')
        return value

    def _not(self, field: str, value: object, wanted: str) -> ValueError:
        return ValueError(f'{self.name_of(field)} is {_short(value)}, not {wanted}')


def _short(value: object) -> str:
    return reprlib.repr(value)[:60]


def _saved_map(fields: _Fields) -> SavedMap:
    correction = fields.within('correction')
    quaternion = correction.array('quaternion', (4,), -1.0 - _ROUNDING, 1.0 + _ROUNDING)
    if abs(np.linalg.norm(quaternion) - 1) > _ROUNDING:
        raise ValueError(f'{correction.name_of("quaternion")} is {quaternion.tolist()}, not a '
                         'rotation')
    planes: list[MapPlane] = []
    labels: set[int] = set()
    left = MOST_CELLS_IN_ALL
    for row in fields.objects('planes', MOST_PLANES):
        planes.append(plane := _plane(row, left))
        left -= plane.cells.hits.size
        if plane.label in labels:
            raise ValueError(f'{row.name_of("label")} is {plane.label}, as that of another plane')
        if plane.cells.size_m != planes[0].cells.size_m:
            raise ValueError(f'{row.name_of("kept.cell")} is {plane.cells.size_m}, that of the '
                             f'first plane is {planes[0].cells.size_m}')
        labels.add(plane.label)
    return SavedMap(
        tuple(planes), RigidTransform.from_quaternion(
            quaternion, correction.array('translation', (3,), -_MOST_M, _MOST_M)),
        fields.text('frame'), fields.time_s('stamp'))


def _plane(row: _Fields, most_cells: int) -> MapPlane:
    kept = row.within('kept')
    axes = kept.array('axes', (3, 3), -1.0 - _ROUNDING, 1.0 + _ROUNDING)
    if abs(axes @ axes.T - np.eye(3)).max() > _ROUNDING or np.linalg.det(axes) < 0:
        raise ValueError(f'{kept.name_of("axes")} are {axes.tolist()}, not a rotation')
    coefficients = kept.array('coefficients', (3,), -_MOST_M, _MOST_M)
    if abs(coefficients[:2]).max() > _MOST_SLOPE:
        raise ValueError(f'{kept.name_of("coefficients")} are {coefficients.tolist()}, '
                         f'slopes above {_MOST_SLOPE:g}')
    return MapPlane(
        row.whole('label', 1, _MOST_LABEL), kept.array('origin', (3,), -_MOST_M, _MOST_M), axes,
        coefficients, _covariance(kept), _cells(kept, most_cells),
        row.whole('views', 1, _MOST_COUNT), row.time_s('first_seen'), row.time_s('last_seen'), 0,
        row.array('votes', (CLASSES,), 0.0, _MOST_COUNT),
        frozenset(row.wholes('apart', 1, _MOST_LABEL, MOST_PLANES)))


def _covariance(kept: _Fields) -> np.ndarray:
    """Return a covariance that is positive definite whatever its scale."""
    covariance = kept.array('covariance', (3, 3), -_MOST_VARIANCE, _MOST_VARIANCE)
    variances = np.diag(covariance)
    if variances.min() >= _LEAST_VARIANCE:
        deviations = np.sqrt(variances)
        correlations = covariance / np.outer(deviations, deviations)
        if (abs(correlations - correlations.T).max() < _ROUNDING
                and np.linalg.eigvalsh(correlations)[0] > _LEAST_EIGENVALUE):
            return covariance
    raise ValueError(f'{kept.name_of("covariance")} is {covariance.tolist()}, not symmetric and '
                     'positive definite')


def _cells(kept: _Fields, most: int) -> Cells:
    """Return the cells, whose number is checked before they are created."""
    low = kept.wholes('low', -MOST_CELLS, MOST_CELLS, 2)
    columns = kept.whole('columns', 0, 2 * MOST_CELLS)
    runs = kept.wholes('runs', 0, most, most + 1)
    rows, rest = divmod(sum(runs), max(columns, 1))
    if len(low) != 2 or rest or low[0] + columns > MOST_CELLS or low[1] + rows > MOST_CELLS:
        raise ValueError(f'{kept.name_of("runs")} of {sum(runs)} cells, columns {columns} and low '
                         f'{low} are no rectangle within {MOST_CELLS} cells of 0')
    if sum(runs) > most:
        raise ValueError(f'{kept.name_of("runs")}: the planes have more than {MOST_CELLS_IN_ALL} '
                         'cells')
    if not sum(runs[1::2]):
        raise ValueError(f'{kept.name_of("runs")} have no seen cell')
    is_seen = (np.arange(len(runs)) % 2).astype(np.uint8)
    counts = np.repeat(is_seen, runs).reshape(rows, columns) * np.uint8(MOST_LOOKS // 2)
    return Cells((low[0], low[1]), counts, counts.copy(), kept.number('cell', *_CELL_M))
