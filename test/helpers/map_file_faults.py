# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Files of maps that are not as they should be: one odd field at a time, then odd bytes."""

import copy
import json
import math
from collections.abc import Iterator

import numpy as np

ODD = (math.nan, math.inf, -math.inf, 1e300, -1e300, 1e-300, 10**400, 2**40, 2**31, -1, 0, 1, 0.5,
       1e11, True, None, '', 'x', '\x1b[2J', [], {}, [[]], [0], [1e11] * 4, [-1, -1], [0, 2**40])


def set_field(content: dict, path: str, value: object) -> str:
    """Return a file, as text, in which the field at a path, as planes.0.label, is another one."""
    changed = copy.deepcopy(content)
    *parents, last = [int(one) if one.isdigit() else one for one in path.split('.')]
    place = changed
    for parent in parents:
        place = place[parent]
    place[last] = value
    return json.dumps(changed)


def odd_fields(content: dict) -> Iterator[tuple[str, str]]:
    """Yield files, as text, with one field that is odd or missing, and what it is."""
    for path in _paths(content, ''):
        for value in ODD:
            yield f'{path} = {str(value)[:20]}', set_field(content, path, value)
        if not path.split('.')[-1].isdigit():
            *parents, last = [int(one) if one.isdigit() else one for one in path.split('.')]
            changed = copy.deepcopy(content)
            place = changed
            for parent in parents:
                place = place[parent]
            del place[last]
            yield f'no {path}', json.dumps(changed)


def _paths(value: object, path: str) -> Iterator[str]:
    """Yield the paths of all fields; of lists those of the first and the last element."""
    if isinstance(value, dict):
        names = list(value)
    elif isinstance(value, list):
        names = sorted({0, len(value) - 1}) if value else []
    else:
        return
    for name in names:
        own = f'{path}.{name}' if path else str(name)
        yield own
        yield from _paths(value[name], own)


def odd_bytes(text: str, rng: np.random.Generator, count: int) -> Iterator[tuple[str, bytes]]:
    """Yield files of which some bytes are others, missing or there twice."""
    for k in range(count):
        data = bytearray(text.encode())
        for _ in range(int(rng.integers(1, 6))):
            at, kind = int(rng.integers(len(data))), int(rng.integers(4))
            length = int(rng.integers(1, 20))
            if kind == 0:
                data[at] = int(rng.integers(256))
            elif kind == 1:
                data[at] = ord(rng.choice(list('0123456789-eE[]{},:".nt')))
            elif kind == 2:
                del data[at:at + length]
            else:
                data[at:at] = data[at:at + length]
        yield f'bytes {k}', bytes(data)


def hostile() -> dict[str, bytes]:
    """Return files that cost much to read."""
    one = b'{"version":1,"frame":"odom","planes":['
    return {
        'deep': b'[' * 200_000, 'deep objects': b'{"a":' * 100_000,
        'many objects': b'[' + b'{"a":1},' * 5_000_000 + b'0]',
        'many numbers': b'[' + b'1.5,' * 9_000_000 + b'0]',
        'many texts': b'[' + b'"ab",' * 7_000_000 + b'0]',
        'long number': b'{"version":' + b'9' * 5_000_000 + b'}',
        'long text': b'{"version":1,"frame":"' + b'x' * 31_000_000 + b'"}',
        'no end': one + b'{},' * 500_000, 'nothing': b'', 'zeros': bytes(1_000_000)}
