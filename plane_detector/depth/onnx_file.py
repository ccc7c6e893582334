# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Check of an ONNX file from an untrusted source, before ONNX Runtime (1.23.2) opens it.

- It may store weights in other files, given by paths. ONNX Runtime follows any path, so that the
  file could read arbitrary files.
- Its functions may call each other. A function that calls itself crashes ONNX Runtime; functions
  that each call the next one twice, or deeply nested graphs, take for ever to load.

The file is a protocol buffers message (onnx/onnx.proto3). Only the fields that lead to the
``external_data`` of a tensor, and the names of operators and functions, are parsed; all others are
skipped by their length.
"""

from __future__ import annotations

import mmap
import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
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
_OP_TYPE, _OP_DOMAIN = 4, 7  # of a NodeProto
_FUNCTION_NAME, _FUNCTION_DOMAIN = 1, 10  # of a FunctionProto
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_MOST_VARINT_BYTES = 10
MOST_FIELDS = 5_000_000
"""More than any network has; a malicious file with more could take minutes."""
MOST_NODES = 1_000_000
"""After all functions are expanded; the largest network has some ten thousand."""
MOST_NESTED = 8
"""Nested graphs, such as the branches of If; exported networks have 2 or 3."""
MOST_CALLS = 64
"""Functions in a chain of calls; exporters make one per module, 10 or so deep."""
_MEMORY_ADDRESS = '_ORT_MEM_ADDR_'  # of ONNX Runtime: the offset is an address in memory


def check_file(path: Path) -> None:
    """
    Refuse an ONNX file that refers to a file outside its folder, or takes too long to load.

    If the file is a link, as in the cache of Hugging Face, the folder of its target is allowed
    too.

    Raises
    ------
    ValueError
        It is not a complete ONNX file, refers to a file that is missing or elsewhere, or has too
        many functions or graphs.
    OSError
        It cannot be read.

    """
    if path.suffix.lower() == '.ort':
        raise ValueError(f'{path} is in the format of ONNX Runtime, not ONNX: give the .onnx file')
    folders = (path.parent.resolve(), path.resolve().parent)
    contents = read_contents(path)
    try:
        contents.check_size()
    except ValueError as error:
        raise ValueError(f'{path} is not loaded: {error}') from None
    for location in sorted(contents.locations):
        try:
            target = (path.parent / location).resolve()
            is_safe = (target.is_file() and _MEMORY_ADDRESS not in location
                       and any(target.is_relative_to(folder) for folder in folders))
        except (ValueError, OSError):  # not a valid path: contains a zero byte or is too long
            is_safe = False
        if not is_safe:
            raise ValueError(f'{path} keeps its weights in {location[:200]!r}, which is no file '
                             'in its folder: it is not loaded')


@dataclass
class Body:
    """The nodes of a graph or of a function, including the graphs inside them."""

    nodes: int = 0
    nested: int = 0  # depth of nested graphs
    # Number of nodes by operator (domain and name, which may be a function) and by the number of
    # enclosing graphs.
    calls: Counter[tuple[tuple[bytes, bytes], int]] = field(default_factory=Counter)


@dataclass
class Contents:
    """The parts of an ONNX file that are checked."""

    locations: set[str] = field(default_factory=set)  # paths of external data of all tensors
    main: Body = field(default_factory=Body)
    functions: dict[tuple[bytes, bytes], Body] = field(default_factory=dict)

    def check_size(self) -> None:
        """Raise ValueError if a function calls itself, or nodes or nested graphs are too many."""
        known: dict[int, tuple[int, int]] = {}

        def expanded(body: Body, callers: tuple[Body, ...]) -> tuple[int, int]:
            """Return the number of nodes and of nested graphs after expansion."""
            if any(body is caller for caller in callers):
                raise ValueError('one of its functions calls itself')
            if len(callers) > MOST_CALLS:
                raise ValueError(f'more than {MOST_CALLS} of its functions call each other')
            if id(body) not in known:
                nodes, nested = body.nodes, body.nested
                for (name, around), count in body.calls.items():
                    if name in self.functions:
                        more, deeper = expanded(self.functions[name], (*callers, body))
                        nodes, nested = nodes + count * more, max(nested, around + deeper)
                if nodes > MOST_NODES:
                    raise ValueError(f'its functions expand to more than {MOST_NODES} nodes')
                if nested > MOST_NESTED:
                    raise ValueError(f'more than {MOST_NESTED} of its graphs are nested')
                known[id(body)] = nodes, nested
            return known[id(body)]

        for body in (self.main, *self.functions.values()):
            expanded(body, ())


def read_contents(path: Path) -> Contents:
    """Return the parts of an ONNX file that are checked."""
    with open(path, 'rb') as file:
        if not os.fstat(file.fileno()).st_size:
            raise ValueError(f'{path} is empty')
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            try:
                return _contents(data)
            except (ValueError, IndexError) as error:
                raise ValueError(f'{path} is not a complete ONNX file: {error}') from None


def _contents(data: mmap.mmap) -> Contents:
    """Walk through the messages of a file."""
    found, budget = Contents(), iter(range(MOST_FIELDS))
    # Kind and place of a message, its function or graph, and the number of enclosing graphs.
    waiting = [('ModelProto', 0, len(data), found.main, 0)]
    while waiting:
        kind, start, end, body, around = waiting.pop()
        parts = [(number, begin, stop) for number, wire, begin, stop
                 in _fields(data, start, end, budget) if wire == _BYTES]

        def text(wanted: int, parts: list = parts) -> bytes:
            return next((data[begin:stop] for number, begin, stop in reversed(parts)
                         if number == wanted), b'')
        if kind == 'FunctionProto':
            name = _operator(text(_FUNCTION_DOMAIN), text(_FUNCTION_NAME))
            body, around = found.functions.setdefault(name, Body()), 0
        elif kind == 'NodeProto':
            body.nodes += 1
            body.calls[_operator(text(_OP_DOMAIN), text(_OP_TYPE)), around] += 1
        elif kind == 'AttributeProto':
            around += 1
        elif kind == 'GraphProto':
            body.nested = max(body.nested, around)
        elif kind == 'StringStringEntryProto':
            texts = [(number, data[begin:stop]) for number, begin, stop in parts]
            if (_KEY, b'location') in texts:  # fields may repeat: readers differ in which counts
                found.locations.update(
                    os.fsdecode(value) for number, value in texts if number == _VALUE)
        waiting += [(MESSAGES[kind][number], begin, stop, body, around)
                    for number, begin, stop in parts if number in MESSAGES[kind]]
    return found


def _operator(domain: bytes, name: bytes) -> tuple[bytes, bytes]:
    return b'' if domain == b'ai.onnx' else domain, name


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
