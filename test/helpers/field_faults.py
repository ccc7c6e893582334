# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Messages of which one field has an extreme value.

Several fields at once are nearly always refused because of one of them: what the others do is not
seen.
"""

from __future__ import annotations

import array
import math
from collections.abc import Iterator
from copy import deepcopy
from typing import Any

import numpy as np

REALS = (0.0, -1.0, math.nan, math.inf, -math.inf, 1e308, -1e308, 1e-308, 1e38, 1e-38)
COUNTS = (0, 1, 2, 2**16, 2**31 - 1, 2**32 - 1)
TEXTS = ('', '\x1b[2J\r\n\t', 'ü', 'x' * 10_000)
ENCODINGS = (*TEXTS, 'rgb8', 'mono16', '8UC1', '16UC1', '32FC1', '64FC1', 'bayer_rggb8', 'nv12',
             'yuv422', 'bgra16', 'R_FLOAT32', 'RGB8 ')
MODELS = (*TEXTS, 'plumb_bob', 'rational_polynomial', 'equidistant', 'fisheye', 'thin_prism')


def changed(msg: Any, path: str, value: Any) -> Any:
    """Return a copy of a message with another value at a path such as ``roi.width`` or ``k.0``."""
    result = deepcopy(msg)
    *parents, last = path.split('.')
    holder = result
    for name in parents:
        holder = getattr(holder, name)
    if last.isdigit():
        holder[int(last)] = value
    else:
        setattr(holder, last, value)
    return result


def one_field_each(msg: Any, values: dict[str, tuple]) -> Iterator[tuple[str, Any]]:
    """Yield a name and a message for each value of each path."""
    kind = type(msg).__name__
    for path, choices in values.items():
        for value in choices:
            shown = repr(value) if len(repr(value)) < 30 else f'{repr(value)[:20]}...'
            yield f'{kind}.{path} = {shown}', changed(msg, path, value)


HEADER = {'header.frame_id': TEXTS, 'header.stamp.sec': (0, -(2**31), 2**31 - 1),
          'header.stamp.nanosec': (0, 2**32 - 1)}


def camera_infos(msg: Any) -> Iterator[tuple[str, Any]]:
    """Yield changed CameraInfo; R, P and D have an effect where D is not zero."""
    numbers = {f'{name}.{k}': REALS for name in 'krp' for k in range(len(getattr(msg, name)))}
    sizes = dict.fromkeys(('height', 'width', 'binning_x', 'binning_y', 'roi.x_offset',
                           'roi.y_offset', 'roi.height', 'roi.width'), COUNTS)
    yield from one_field_each(msg, {**HEADER, **sizes, **numbers, 'distortion_model': MODELS})
    for k in range(5):
        for value in REALS:
            bent = changed(msg, 'd', [0.0] * k + [value] + [0.0] * (4 - k))
            yield f'CameraInfo.d.{k} = {value!r}', bent
    for count in (1, 4, 8, 14, 1000):
        yield f'CameraInfo.d of {count}', changed(msg, 'd', [0.01] * count)
    for name in ('k', 'r', 'p'):
        for value in REALS:
            yield (f'CameraInfo.{name} all {value!r}',
                   changed(msg, name, np.full(len(getattr(msg, name)), value)))


def images(msg: Any) -> Iterator[tuple[str, Any]]:
    """Yield changed images."""
    yield from one_field_each(msg, {**HEADER, 'height': COUNTS, 'width': COUNTS, 'step': COUNTS,
                                    'encoding': ENCODINGS, 'is_bigendian': (1, 255)})
    kind = type(msg).__name__
    for name, data in {'no data': b'', 'one byte': b'\0', 'half': bytes(msg.data)[::2],
                       'twice': 2 * bytes(msg.data), 'all 255': b'\xff' * len(msg.data),
                       'all 0': bytes(len(msg.data))}.items():
        yield f'{kind} {name}', changed(msg, 'data', array.array('B', data))


def depths(msg: Any) -> Iterator[tuple[str, Any]]:
    """Yield changed images of depth, 32FC1."""
    yield from images(msg)
    pixels = np.frombuffer(bytes(msg.data), np.float32)
    for value in (*REALS, 1e-3, 1e4):
        for share in (0.5, 1.0):
            odd = pixels.copy()
            odd[:round(share * len(odd))] = np.float32(value) if abs(value) < 1e39 else (
                math.copysign(3e38, value) if math.isfinite(value) else value)
            yield (f'depth {value!r} in {share:.0%}',
                   changed(msg, 'data', array.array('B', odd.tobytes())))


def imus(msg: Any) -> Iterator[tuple[str, Any]]:
    """Yield changed readings."""
    fields = [f'{vector}.{axis}' for vector in ('linear_acceleration', 'angular_velocity')
              for axis in 'xyz'] + [f'orientation.{axis}' for axis in 'xyzw']
    yield from one_field_each(msg, {**HEADER, **dict.fromkeys(fields, REALS)})


def transforms(msg: Any) -> Iterator[tuple[str, Any]]:
    """Yield changed transforms."""
    fields = [f'transform.translation.{axis}' for axis in 'xyz']
    fields += [f'transform.rotation.{axis}' for axis in 'xyzw']
    yield from one_field_each(msg, {**HEADER, 'child_frame_id': TEXTS,
                                    **dict.fromkeys(fields, REALS)})


def clicks(msg: Any) -> Iterator[tuple[str, Any]]:
    """Yield changed points."""
    yield from one_field_each(msg, {**HEADER, **{f'point.{axis}': REALS for axis in 'xyz'}})
