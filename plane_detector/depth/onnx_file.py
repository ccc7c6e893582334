# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Check of the external files that an ONNX file refers to.

An ONNX file may store weights in other files, given by paths. ONNX Runtime (1.23.2) follows any
path, so that a file from an untrusted source could read arbitrary files. The paths are therefore
checked before ONNX Runtime opens the file.

The file is a protocol buffers message (onnx/onnx.proto3). Only the fields that lead to the
``external_data`` of a tensor are parsed; all others are skipped by their length.
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Iterator
from pathlib import Path

# Fields of each message that lead to a tensor, by their numbers in onnx.proto3.
MESSAGES: dict[str, dict[int, str]] = {
    'ModelProto': {7: 'GraphProto', 20: 'TrainingInfoProto', 25: 'FunctionProto'},
    'TrainingInfoProto': {1: 'GraphProto', 2: 'GraphProto'},
    'GraphProto': {1: 'NodeProto', 5: 'TensorProto', 15: 'SparseTensorProto'},
    'FunctionProto': {7: 'NodeProto', 11: 'AttributeProto'},
    'NodeProto': {5: 'AttributeProto'},
    'AttributeProto': {5: 'TensorProto', 6: 'GraphProto', 10: 'TensorProto', 11: 'GraphProto',
                       22: 'SparseTensorProto', 23: 'SparseTensorProto'},
    'SparseTensorProto': {1: 'TensorProto', 2: 'TensorProto'},
    'TensorProto': {13: 'StringStringEntryProto'},
    'StringStringEntryProto': {}}
_KEY, _VALUE = 1, 2  # of a StringStringEntryProto
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_MOST_VARINT_BYTES = 10
MOST_FIELDS = 5_000_000
"""More than any network has; a malicious file with more could take minutes."""
_MEMORY_ADDRESS = '_ORT_MEM_ADDR_'  # of ONNX Runtime: the offset is an address in memory


def check_external_data(path: Path) -> None:
    """
    Refuse an ONNX file that refers to a file outside its own folder.

    If the file is a link, as in the cache of Hugging Face, the folder of its target is allowed
    too.

    Raises
    ------
    ValueError
        It is not a complete ONNX file, or refers to a file that is missing or elsewhere.
    OSError
        It cannot be read.

    """
    if path.suffix.lower() == '.ort':
        raise ValueError(f'{path} is in the format of ONNX Runtime, not ONNX: give the .onnx file')
    folders = (path.parent.resolve(), path.resolve().parent)
    for location in sorted(external_locations(path)):
        try:
            target = (path.parent / location).resolve()
            is_safe = (target.is_file() and _MEMORY_ADDRESS not in location
                       and any(target.is_relative_to(folder) for folder in folders))
        except (ValueError, OSError):  # not a valid path: contains a zero byte or is too long
            is_safe = False
        if not is_safe:
            raise ValueError(f'{path} keeps its weights in {location[:200]!r}, which is no file '
                             'in its folder: it is not loaded')


def external_locations(path: Path) -> set[str]:
    """Return the paths of external data of all tensors in an ONNX file."""
    with open(path, 'rb') as file:
        if not os.fstat(file.fileno()).st_size:
            raise ValueError(f'{path} is empty')
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            try:
                return set(_locations(data))
            except (ValueError, IndexError) as error:
                raise ValueError(f'{path} is not a complete ONNX file: {error}') from None


def _locations(data: mmap.mmap) -> Iterator[str]:
    """Yield what a reader may take for the location of a tensor's data."""
    budget = iter(range(MOST_FIELDS))
    waiting = [('ModelProto', 0, len(data))]
    while waiting:
        kind, start, end = waiting.pop()
        parts = [(number, begin, stop) for number, wire, begin, stop
                 in _fields(data, start, end, budget) if wire == _BYTES]
        waiting += [(MESSAGES[kind][number], begin, stop) for number, begin, stop in parts
                    if number in MESSAGES[kind]]
        if kind == 'StringStringEntryProto':
            texts = [(number, data[begin:stop]) for number, begin, stop in parts]
            if (_KEY, b'location') in texts:  # fields may repeat: readers differ in which counts
                yield from (os.fsdecode(text) for number, text in texts if number == _VALUE)


def _fields(data: mmap.mmap, start: int, end: int,
            budget: Iterator[int]) -> Iterator[tuple[int, int, int, int]]:
    """Yield number, wire type, start and end of each field of a message."""
    while start < end:
        if next(budget, None) is None:
            raise ValueError(f'it has more than {MOST_FIELDS} fields')
        tag, start = _varint(data, start, end)
        number, wire = tag >> 3, tag & 7
        if wire == _VARINT:
            stop = _varint(data, start, end)[1]
        elif wire == _BYTES:
            length, start = _varint(data, start, end)
            stop = start + length
        elif wire in (_FIXED64, _FIXED32):
            stop = start + (8 if wire == _FIXED64 else 4)
        else:  # groups, which ONNX does not use
            raise ValueError(f'byte {start} starts no field of ONNX')
        # Some readers truncate field numbers above 29 bits, which then name another field.
        if stop > end or not 0 < number < 1 << 29:
            raise ValueError(f'the field at byte {start} does not fit in')
        yield number, wire, start, stop
        start = stop


def _varint(data: mmap.mmap, start: int, end: int) -> tuple[int, int]:
    """Return the integer of variable length at ``start``, and its end."""
    value = 0
    for k in range(min(_MOST_VARINT_BYTES, end - start)):
        byte = data[start + k]
        value |= (byte & 0x7f) << (7 * k)
        if byte < 0x80:
            return value, start + k + 1
    raise ValueError(f'it breaks off in a number at byte {start}')
