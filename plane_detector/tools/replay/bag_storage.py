# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Files of a rosbag2 that contain only complete frames, however the writing ends.

The writers of rosbags use one transaction, or chunks that end anywhere. Here `commit` is called
between two frames: committed data stays in the file if the process is killed, and uncommitted data
is removed if the disk is full.
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

# derived: room for the data written when the bag is closed: type definitions (about 30 kB for all
# outputs), bag metadata (1 kB per topic), and in an mcap file the index of its chunks.
_CLOSING_BYTES = 1 << 20
_CLOSING_BYTES_PER_CHUNK = 1024
_RESERVE_NAME = 'reserve'


class CommittingSqlite3(Sqlite3Writer):
    """A .db3 file in which every commit is a transaction."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        # Uncommitted pages stay in memory, so that a killed process leaves a valid file.
        self.conn.execute('PRAGMA cache_spill=OFF')

    def commit(self) -> None:
        """Write everything since the last commit to the file."""
        self.conn.commit()

    def discard(self) -> None:
        """Remove everything written since the last commit."""
        self.conn.rollback()

    def close(self, version: int, metadata: str) -> None:
        """Close the file; without its copy of metadata.yaml if the disk is full."""
        try:
            super().close(version, metadata)
        except sqlite3.Error:
            self.conn.rollback()
            self.conn.close()


class CommittingMcap(McapWriter):
    """A .mcap file in which every commit ends a chunk, with space reserved for its index."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        self._remember()

    def close_chunk(self) -> None:
        """Do nothing: the base class ends chunks by size, even within a frame."""

    def commit(self) -> None:
        """Write the chunk; after a failure the file is unchanged and can be closed."""
        if not self.chunk.bio.tell():
            return
        start = self.bio.tell()
        closing = _CLOSING_BYTES + _CLOSING_BYTES_PER_CHUNK * (len(self.chunks) + 1)
        # Reserved first, because a partly written chunk could not be removed.
        os.posix_fallocate(self.bio.fileno(), start, 2 * self.chunk.bio.tell() + closing)
        super().close_chunk()
        self.bio.flush()
        self._remember()

    def discard(self) -> None:
        """Remove everything written since the last commit."""
        self.chunk = PendingChunk(MAXSIZE, 0, BytesIO(), defaultdict(list))
        self.channel_stats, self.message_start_time, self.message_end_time = self._sound
        self._remember()

    def close(self, version: int, metadata: str) -> None:
        """Write the index and release the reserved space after it."""
        self.commit()
        descriptor = os.dup(self.bio.fileno())  # shares the position; outlives the file object
        try:
            super().close(version, metadata)
            os.ftruncate(descriptor, os.lseek(descriptor, 0, os.SEEK_CUR))
        finally:
            os.close(descriptor)

    def _remember(self) -> None:
        self._sound = (dict(self.channel_stats), self.message_start_time, self.message_end_time)


class CommittingWriter(Writer):
    """
    A rosbag2 of complete frames.

    Between two calls of `commit` nothing is permanently written to the file. If a commit fails,
    the bag can still be closed, and contains what was committed before.
    """

    STORAGE_PLUGINS = {StoragePlugin.SQLITE3: CommittingSqlite3,
                       StoragePlugin.MCAP: CommittingMcap}

    def open(self) -> None:
        """Create the folder and its file."""
        super().open()
        self._remember()
        with open(self.path / _RESERVE_NAME, 'wb') as file:
            os.posix_fallocate(file.fileno(), 0, _CLOSING_BYTES)

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Write a message; raises OSError if there is no space."""
        try:
            super().write(connection, timestamp, data)
        except sqlite3.Error as error:
            raise OSError(f'{self.path} cannot be written: {error}') from error

    def commit(self) -> None:
        """
        Write everything so far to the file.

        Raises
        ------
        OSError
            There is no space; the uncommitted data was removed.

        """
        try:
            self.storage.commit()
        except (OSError, sqlite3.Error) as error:
            self.storage.discard()
            counts, self.min_timestamp, self.max_timestamp = self._sound
            # Topics announced since then keep their entry, which closing needs.
            self.counts = dict.fromkeys(self.counts, 0) | counts
            raise OSError(f'{self.path} cannot be written: {error}') from error
        self._remember()

    def close(self) -> None:
        """Close the file and write metadata.yaml, for which space is reserved."""
        (self.path / _RESERVE_NAME).unlink()
        super().close()

    def _remember(self) -> None:
        self._sound = (dict(self.counts), self.min_timestamp, self.max_timestamp)
