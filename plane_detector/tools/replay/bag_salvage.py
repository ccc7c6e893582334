# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Repair of a bag whose writing by this package was interrupted."""

from __future__ import annotations

import sqlite3
import struct
from pathlib import Path

_MAGIC = b'\x89MCAP0\r\n'
# Records of an mcap file, by their opcode: https://mcap.dev/spec
_HEADER, _FOOTER, _CHUNK, _MESSAGE_INDEX, _DATA_END = 0x01, 0x02, 0x06, 0x07, 0x0F
_RECORD = struct.Struct('<BQ')


def salvage(folder: Path) -> bool:
    """
    Make the folder of a killed writer readable, with everything that was committed.

    Parameters
    ----------
    folder : Path
        Folder written by a `CommittingWriter`, closed or not. The file in it is changed.

    Returns
    -------
    bool
        Whether there is a readable file.

    Raises
    ------
    OSError
        The file cannot be repaired.

    """
    if (folder / 'metadata.yaml').exists():
        return True
    files = [file for file in folder.glob('*') if file.suffix in ('.mcap', '.db3')]
    if len(files) != 1:
        return False
    return _close_mcap(files[0]) if files[0].suffix == '.mcap' else _roll_back(files[0])


def _roll_back(path: Path) -> bool:
    """Open and close the database: SQLite rolls an incomplete commit back."""
    try:
        connection = sqlite3.connect(path)
        try:
            return connection.execute('SELECT count(*) FROM topics').fetchone()[0] > 0
        finally:
            connection.close()
    except sqlite3.Error as error:
        raise OSError(f'{path} cannot be read: {error}') from error


def _close_mcap(path: Path) -> bool:
    """Truncate a file after its last complete chunk and write the end that readers need."""
    with open(path, 'r+b') as file:
        end = _end_of_chunks(file)
        if not end:
            return False
        file.seek(end)
        file.truncate()
        file.write(_RECORD.pack(_DATA_END, 4) + bytes(4))
        file.write(_RECORD.pack(_FOOTER, 20) + bytes(20) + _MAGIC)
    return True


def _end_of_chunks(file) -> int:
    """Return the end of the index after the last complete chunk; 0 if there is none."""
    size = file.seek(0, 2)
    position, end = file.seek(len(_MAGIC)), 0
    while len(head := file.read(_RECORD.size)) == _RECORD.size:
        code, length = _RECORD.unpack(head)
        position += _RECORD.size + length
        if code not in (_HEADER, _CHUNK, _MESSAGE_INDEX) or position > size:
            break
        if code == _MESSAGE_INDEX:  # follows its chunk, which is therefore complete
            end = position
        file.seek(position)
    return end
