# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Files of a rosbag2 that hold whole frames only, whatever ends the writing.

The writers of rosbags keep what they got in one transaction, or in chunks that end anywhere. Here
`commit` is called between two frames: what was committed is in the file and stays there when the
process is killed, and what was not is taken back when the disk is full.
"""

from __future__ import annotations

import os
import sqlite3
from collections import defaultdict
from io import BytesIO
from pathlib import Path

from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import MAXSIZE, McapWriter, PendingChunk
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

# derived: room for what is written when the bag is closed: type definitions (about 30 kB for all
# outputs), bag metadata (1 kB a topic), and in an mcap file the index of its chunks.
_CLOSING_BYTES = 1 << 20
_CLOSING_BYTES_PER_CHUNK = 1024
_RESERVE_NAME = 'reserve'


class CommittingSqlite3(Sqlite3Writer):
    """A .db3 file in which every commit is a transaction."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        # Pages that are not committed stay in memory: a killed process leaves a sound file.
        self.conn.execute('PRAGMA cache_spill=OFF')

    def commit(self) -> None:
        """Bring what was written since the last commit into the file."""
        self.conn.commit()

    def discard(self) -> None:
        """Take back what was written since the last commit."""
        self.conn.rollback()

    def close(self, version: int, metadata: str) -> None:
        """Close the file; its copy of metadata.yaml is left out where the disk is full."""
        try:
            super().close(version, metadata)
        except sqlite3.Error:
            self.conn.rollback()
            self.conn.close()


class CommittingMcap(McapWriter):
    """A .mcap file in which every commit ends a chunk, with room kept for its index."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        self._remember()

    def close_chunk(self) -> None:
        """Do nothing: the base class ends chunks by size, between any two messages."""

    def commit(self) -> None:
        """Write the chunk; on failure the file is as it was, and can be closed."""
        if not self.chunk.bio.tell():
            return
        start = self.bio.tell()
        closing = _CLOSING_BYTES + _CLOSING_BYTES_PER_CHUNK * (len(self.chunks) + 1)
        # Reserved first, as a chunk of which only a part fits could not be taken back.
        os.posix_fallocate(self.bio.fileno(), start, 2 * self.chunk.bio.tell() + closing)
        super().close_chunk()
        self.bio.flush()
        self._remember()

    def discard(self) -> None:
        """Take back what was written since the last commit."""
        self.chunk = PendingChunk(MAXSIZE, 0, BytesIO(), defaultdict(list))
        self.channel_stats, self.message_start_time, self.message_end_time = self._sound
        self._remember()

    def close(self, version: int, metadata: str) -> None:
        """Write the index and give back what was reserved beyond it."""
        self.commit()
        descriptor = os.dup(self.bio.fileno())  # shares the position, and outlives the file object
        try:
            super().close(version, metadata)
            os.ftruncate(descriptor, os.lseek(descriptor, 0, os.SEEK_CUR))
        finally:
            os.close(descriptor)

    def _remember(self) -> None:
        self._sound = (dict(self.channel_stats), self.message_start_time, self.message_end_time)


class CommittingWriter(Writer):
    """
    A rosbag2 of whole frames.

    Between `commit` and the next one nothing reaches the file for good; when a commit fails the
    bag can still be closed, and holds what was committed before.
    """

    STORAGE_PLUGINS = {StoragePlugin.SQLITE3: CommittingSqlite3,
                       StoragePlugin.MCAP: CommittingMcap}

    def open(self) -> None:
        """Make the folder and its file."""
        super().open()
        self._remember()
        with open(self.path / _RESERVE_NAME, 'wb') as file:
            os.posix_fallocate(file.fileno(), 0, _CLOSING_BYTES)

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Write a message; an OSError where there is no room for it."""
        try:
            super().write(connection, timestamp, data)
        except sqlite3.Error as error:
            raise OSError(f'{self.path} cannot be written: {error}') from error

    def commit(self) -> None:
        """
        Bring everything written so far into the file.

        Raises
        ------
        OSError
            There is no room for it; it was taken back.

        """
        try:
            self.storage.commit()
        except (OSError, sqlite3.Error) as error:
            self.storage.discard()
            counts, self.min_timestamp, self.max_timestamp = self._sound
            # Topics that came since then keep their entry, which closing asks for.
            self.counts = dict.fromkeys(self.counts, 0) | counts
            raise OSError(f'{self.path} cannot be written: {error}') from error
        self._remember()

    def close(self) -> None:
        """Close the file and write metadata.yaml, for which room was kept."""
        (self.path / _RESERVE_NAME).unlink()
        super().close()

    def _remember(self) -> None:
        self._sound = (dict(self.counts), self.min_timestamp, self.max_timestamp)
