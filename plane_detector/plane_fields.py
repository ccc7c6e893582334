# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The attributes of planes: one row of :class:`PlaneColumns` each, and everything derived from it.

A row determines the attribute of `Plane`, the array of `Planes`, how it changes with the frame and
with the unit of length, the fields of ``~/planes`` and their table in docs/topics.md, the names in
JSON and the columns of CSV. To add an attribute, add a row, and compute its values where planes
are measured, in planes/measurement.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import Enum, IntEnum, auto
from functools import cache
from typing import Any, Protocol, TypeVar

import numpy as np

# Power of the unit of length in each unit, for a change of that unit.
POWERS = {'': 0, 'px': 0, 'rad': 0, 'm': 1, 'm^2': 2}
# Types in messages by types in the core.
_WIRE_TYPES = {np.dtype(float): '<f4', np.dtype(np.int64): '<u4', np.dtype(np.uint8): 'u1'}
_COLUMN = 'column'
Table = TypeVar('Table', bound='Columns')


class PlaneClass(IntEnum):
    """Values of the field ``class`` of ``~/planes``."""

    UNKNOWN = 0
    FLOOR = 1
    CEILING = 2
    WALL = 3
    OTHER_HORIZONTAL = 4
    OTHER = 5
    RAMP = 6
    STEP = 7

    @property
    def readable(self) -> str:
        """The name in lower case, with spaces."""
        return self.name.lower().replace('_', ' ')


class Motion(Protocol):
    """A change of frame: p_target = rotation @ p_source + translation_m."""

    @property
    def rotation(self) -> np.ndarray:
        """Rotation, (3, 3)."""

    @property
    def translation_m(self) -> np.ndarray:
        """Translation, (3,)."""


class Moves(Enum):
    """How values change by p' = s R p + t, a motion (R, t) after a change of the unit by s."""

    SCALAR = auto()    # s^power v
    DIRECTION = auto()  # R n
    POINT = auto()     # s R p + t
    OFFSET = auto()    # s d - t . R n, of the first column
    ROTATION = auto()  # R A
    COVARIANCE = auto()  # of a normal and its offset: J C J^T for J = [[R, 0], [-t^T R, s]]


@dataclass(frozen=True)
class Published:
    """Fields of ``~/planes`` made from a column; its unit and doc are theirs unless given."""

    names: str  # separated by spaces
    json: str = ''  # name in JSON; empty: not there
    unit: str = ''
    doc: str = ''
    of: Callable[[np.ndarray], np.ndarray] | None = None  # column -> (K,) or (K, fields)
    digits: int = 4  # in JSON, after the point; metres to a tenth of a millimetre


@dataclass(frozen=True)
class Column:
    """One attribute."""

    one: str  # its name for a single plane
    unit: str
    shape: tuple[int, ...]  # for a single plane
    dtype: np.dtype
    moves: Moves
    default: Any  # of columns that are not given; None: required
    kind: Callable[[Any], Any] | None  # of a single value; None: by the dtype
    published: tuple[Published, ...]

    def value(self, values: np.ndarray) -> Any:
        """Return a single value in the form that `Plane` has."""
        if self.shape:
            return values
        return self.kind(values) if self.kind else values.item()


def column(one: str, *published: Published, unit: str = '', shape: tuple[int, ...] = (),
           dtype: type = float, moves: Moves = Moves.SCALAR, default: Any = None,
           kind: Callable[[Any], Any] | None = None, doc: str = '') -> Any:
    """Return a field of a dataclass of columns, see :class:`Column`."""
    row = Column(one, unit, shape, np.dtype(dtype), moves, default, kind, tuple(
        replace(part, unit=part.unit or unit, doc=part.doc or doc) for part in published))
    if default is None:
        return field(metadata={_COLUMN: row})
    return field(default=None, metadata={_COLUMN: row})


@cache
def columns_of(table: type[Columns]) -> dict[str, Column]:
    """Return the columns of a class by their names."""
    return {one.name: one.metadata[_COLUMN] for one in fields(table)}


class Columns:
    """Arrays of K rows; subclasses are dataclasses whose fields are made by :func:`column`."""

    def __post_init__(self) -> None:
        for name, row in columns_of(type(self)).items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.full(
                    (len(self), *row.shape), row.default, row.dtype))

    def __len__(self) -> int:
        return len(getattr(self, next(iter(columns_of(type(self))))))

    def selected(self: Table, index: slice | np.ndarray | Sequence[int]) -> Table:
        """
        Return some of the rows, by a slice, by a mask (K,) bool or by their indices.

        Raises
        ------
        IndexError
            As for an array: a mask of another length, an index out of range, or several
            dimensions.

        """
        if not isinstance(index, slice):
            index = np.asarray(index) if len(index) else np.zeros(0, np.int64)
            if index.ndim != 1:
                raise IndexError('planes have one dimension: index them by a slice, a mask (K,) '
                                 f'or indices (N,), not by an array of shape {index.shape}')
        return type(self)(*(getattr(self, name)[index] for name in columns_of(type(self))))

    def concatenated(self: Table, others: Table) -> Table:
        """Return these rows and others, which are in the same frame."""
        return type(self)(*(np.concatenate([getattr(self, name), getattr(others, name)])
                            for name in columns_of(type(self))))

    def moved(self: Table, motion: Motion, scale: float = 1.0) -> Table:
        """
        Return the rows in another frame, in which lengths are ``scale`` times as large.

        Normals still point toward the camera, so offsets may be negative there.
        """
        moved: dict[str, np.ndarray] = {}
        for name, row in columns_of(type(self)).items():
            moved[name] = _moved(row, getattr(self, name), motion, scale,
                                 next(iter(moved.values()), np.zeros((0, 3))))
        return type(self)(**moved)

    def row(self, index: int) -> list[Any]:
        """Return the values of one row."""
        return [row.value(getattr(self, name)[index])
                for name, row in columns_of(type(self)).items()]

    def write_to(self, table: np.ndarray) -> None:
        """Write the published fields to rows of a structured array."""
        for name, row in columns_of(type(self)).items():
            for part in row.published:
                values = getattr(self, name)
                values = values if part.of is None else part.of(values)
                names = part.names.split()
                for k, one in enumerate(names):
                    table[one] = values if len(names) == 1 else values[:, k]


def _moved(row: Column, values: np.ndarray, motion: Motion, scale: float,
           normals: np.ndarray) -> np.ndarray:
    """Return a column in another frame, for the moved normals, see :class:`Moves`."""
    rotation, translation_m = motion.rotation, motion.translation_m
    if row.moves is Moves.DIRECTION:
        return values @ rotation.T
    if row.moves is Moves.POINT:
        return scale * (values @ rotation.T) + translation_m
    if row.moves is Moves.OFFSET:
        return scale * values - normals @ translation_m
    if row.moves is Moves.ROTATION:
        return rotation @ values
    if row.moves is Moves.COVARIANCE:
        jacobian = np.zeros((4, 4))
        jacobian[:3, :3], jacobian[3, 3] = rotation, scale
        jacobian[3, :3] = -translation_m @ rotation
        return jacobian @ values @ jacobian.T
    power = POWERS[row.unit]
    return scale**power * values if power else values


def row_of(columns: type[Columns]) -> Callable[[type], type]:
    """Return a decorator: the class becomes a frozen dataclass of one row of the columns."""
    def decorated(cls: type) -> type:
        cls.__annotations__ = {}
        for row in columns_of(columns).values():
            cls.__annotations__[row.one] = np.ndarray if row.shape else (
                row.kind or type(np.zeros((), row.dtype).item()))
            if row.default is not None:
                setattr(cls, row.one, row.default)
        return dataclass(frozen=True)(cls)
    return decorated


def wire_type(row: Column) -> str:
    """Return the type of its fields in a message."""
    return _WIRE_TYPES[row.dtype]


_ROWS, _COLUMNS = np.triu_indices(4)


def _root(variances: np.ndarray) -> np.ndarray:
    """Return standard deviations; rounding may make the variance of an exact value negative."""
    return np.sqrt(np.maximum(variances, 0.0))


@dataclass(frozen=True, eq=False)
class PlaneColumns(Columns):
    """The attributes of planes; a new one is added last, with a default."""

    # (K, 3), of length 1, pointing toward the camera.
    normals: np.ndarray = column(
        'normal', Published('normal_x normal_y normal_z', 'normal'), shape=(3,),
        moves=Moves.DIRECTION, doc='unit normal')
    # At least 0 in the frame of the camera: normal . p + offset = 0.
    offsets_m: np.ndarray = column(
        'offset_m', Published('d', 'd'), unit='m', moves=Moves.OFFSET,
        doc='distance of the camera from the infinite plane')
    # Mean of the pixels' points, projected onto the plane.
    centroids_m: np.ndarray = column(
        'centroid_m', Published('x y z', 'centroid'), unit='m', shape=(3,), moves=Moves.POINT,
        doc='centroid, on the plane')
    # At least 1; more pixels may have its label, see `fill_patches`.
    counts: np.ndarray = column(
        'inlier_count', Published('num_inliers', 'num_inliers'), unit='px', dtype=np.int64,
        doc='pixels from which the plane was measured')
    rms_m: np.ndarray = column(
        'rms_m', Published('rms', 'rms'), unit='m', doc='root mean square distance of its points')
    areas_m2: np.ndarray = column(
        'area_m2', Published('area', 'area'), unit='m^2',
        doc='visible area: the part of the plane that its pixels cover, without holes; at most '
            'that of the rectangle')
    # (K, 4, 4), of (normal, offset_m), from the fit.
    covariances: np.ndarray = column(
        'covariance',
        Published('sigma_normal', 'sigma_normal', 'rad', 'standard deviation of the normal: root '
                  'of the sum of its variances', lambda values: _root(
                      np.einsum('nii->n', values[:, :3, :3])), digits=6),
        Published('sigma_d', 'sigma_d', 'm', 'standard deviation of `d`',
                  lambda values: _root(values[:, 3, 3]), digits=6),
        Published(' '.join(f'cov_{"xyzd"[i]}{"xyzd"[j]}'
                           for i, j in zip(_ROWS.tolist(), _COLUMNS.tolist(), strict=True)),
                  doc='covariance of `normal_x` `normal_y` `normal_z` `d`, the upper triangle by '
                      'rows; in m for each `d`. See [covariance](#covariance)',
                  of=lambda values: values[:, _ROWS, _COLUMNS]),
        shape=(4, 4), moves=Moves.COVARIANCE)
    confidences: np.ndarray = column(
        'confidence', Published('confidence', 'confidence'),
        doc='probability that the plane exists in the scene, 0 to 1; low in measured depth that '
            'is rough for its extent; of a network\'s plane times that of its orientation (within '
            '15 degrees)')
    # Probability that the plane is horizontal, vertical or neither, as its normal indicates, if
    # lines of the image oriented it; NaN: only depth did, and the covariance shows how well.
    class_certainties: np.ndarray = column('class_certainty', default=float('nan'))
    classes: np.ndarray = column(
        'plane_class', Published('class', 'class'), dtype=np.uint8, kind=PlaneClass,
        default=PlaneClass.UNKNOWN,
        doc=f'{", ".join(f"{kind.value} {kind.readable}" for kind in PlaneClass)}; '
            'see [classes](#classes)')
    # Above 0, the same from image to image if tracked; 0: not labelled.
    labels: np.ndarray = column(
        'label', Published('label', 'label'), dtype=np.int64, default=0,
        doc='the label in `~/points` and `~/labels`; persistent with `tracking.enabled`')
    merged: np.ndarray = column(
        'merged', Published('merged'), dtype=np.int64, default=0,
        doc='label of a plane that was merged into this one in this image, 0: none')
