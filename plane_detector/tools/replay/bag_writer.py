# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Writing of results as a rosbag2, which `ros2 bag`, RViz and Foxglove open."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rclpy.serialization import serialize_message
from rosbags.interfaces import (
    Connection,
    MessageDefinitionFormat,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_typestore

from plane_detector.tools.replay.bag_reader import BagError, BagReader, Recorded
from plane_detector.tools.replay.bag_storage import CommittingWriter

STORAGES = {'mcap': StoragePlugin.MCAP, 'sqlite3': StoragePlugin.SQLITE3}
# Chunks of an mcap file are compressed inside the file; sqlite3 has no chunks.
_COMPRESSIONS = {'mcap': CompressionMode.STORAGE, 'sqlite3': CompressionMode.MESSAGE}
_FOREVER = QosTime(2147483647, 4294967295)
# As offered by the node: see ros/qos.py.
_OUTPUT_QOS = Qos(QosHistory.KEEP_LAST, 2, QosReliability.RELIABLE, QosDurability.VOLATILE,
                  _FOREVER, _FOREVER, QosLiveliness.AUTOMATIC, _FOREVER, False)
# The last version whose quality of service can be read by rosbag2 before Jazzy.
_VERSION = 8
# A killed process loses the data after the last commit: a second, or this many bytes.
_COMMIT_PERIOD_S = 1.0
_COMMIT_BYTES = 1 << 22


class BagWriter:
    """
    A new rosbag2; a context manager that always closes it in a readable state.

    Written data survives a killed process, except for the last second, see `end_frame`.

    Parameters
    ----------
    path : Path
        The folder; it must not exist.
    storage : str
        ``mcap`` or ``sqlite3``.
    compressed : bool
        Whether messages are compressed with zstd.

    Attributes
    ----------
    is_full : bool
        Whether there was no space for the last data, which was removed.

    Raises
    ------
    FileExistsError
        The path exists.

    """

    def __init__(self, path: Path, storage: str = 'mcap', compressed: bool = False):
        if os.path.lexists(path):
            raise FileExistsError(f'{path} already exists: choose another name')
        self._types = get_typestore(Stores.ROS2_JAZZY)
        self._writer = CommittingWriter(path, version=_VERSION, storage_plugin=STORAGES[storage])
        if compressed:
            self._writer.set_compression(_COMPRESSIONS[storage], CompressionFormat.ZSTD)
        self._writer.open()
        self._connections: dict[str, Connection] = {}
        self._fields: dict[str, str] = {}
        self._pending_bytes, self._committed_s = 0, time.monotonic()
        self.is_full = False

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._writer.commit()
        finally:
            for name, value in self._fields.items():
                self._writer.set_custom_data(name, value)
            self._writer.close()

    @property
    def topics(self) -> frozenset[str]:
        """Topics announced so far."""
        return frozenset(self._connections)

    def describe(self, fields: Mapping[str, str]) -> None:
        """Put names and values into the metadata, which `ros2 bag info` shows."""
        self._fields.update(fields)

    def add_outputs(self, classes: Mapping[str, Any]) -> None:
        """Announce topics whose messages are of these classes."""
        for topic, message_class in classes.items():
            package, kind = message_class.__module__.split('.')[0], message_class.__name__
            self._connections[topic] = self._writer.add_connection(
                topic, f'{package}/msg/{kind}', typestore=self._types,
                offered_qos_profiles=[_OUTPUT_QOS])

    def add_copies(self, bag: BagReader, topics: tuple[str, ...]) -> None:
        """
        Announce topics of another bag.

        Raises
        ------
        BagError
            The definition of a topic's type is neither in that bag nor known here.

        """
        for topic in topics:
            if topic not in self._connections:  # diagnostics of both share a topic
                self._connections[topic] = self._copied(bag, bag.connection(topic))

    def write(self, topic: str, time_ns: int, msg: Any) -> None:
        """Write a message, or a serialised one; equal messages give equal bytes."""
        kind = self._connections[topic].msgtype
        # The middleware leaves padding between fields uninitialised; rosbags writes zeros.
        data = msg if isinstance(msg, bytes) else serialize_message(msg)
        plain = self._types.deserialize_cdr(data, kind)
        self._put(topic, time_ns, self._types.serialize_cdr(plain, kind))

    def copy(self, recorded: Recorded) -> None:
        """Write a recorded message of an announced topic."""
        self._put(recorded.topic, recorded.time_ns, recorded.cdr)

    def end_frame(self) -> bool:
        """
        Mark the messages of a frame as complete; once per second they are committed.

        Returns
        -------
        bool
            Whether they have been committed.

        Raises
        ------
        OSError
            There is no space for them: the bag contains the frames up to the last commit.

        """
        now_s = time.monotonic()
        if (self._pending_bytes >= _COMMIT_BYTES
                or now_s - self._committed_s >= _COMMIT_PERIOD_S):
            self.commit()
            return True
        return False

    def commit(self) -> None:
        """Commit everything written so far; see `end_frame`."""
        try:
            self._writer.commit()
        except OSError:
            self.is_full = True
            raise
        self._pending_bytes, self._committed_s = 0, time.monotonic()

    def _put(self, topic: str, time_ns: int, cdr: bytes | memoryview) -> None:
        self._writer.write(self._connections[topic], time_ns, cdr)
        self._pending_bytes += len(cdr)

    def _copied(self, bag: BagReader, source: Connection) -> Connection:
        qos = [] if bag.is_ros1 else source.ext.offered_qos_profiles
        if source.msgtype in self._types.fielddefs:
            return self._writer.add_connection(source.topic, source.msgtype,
                                               typestore=self._types, offered_qos_profiles=qos)
        if bag.is_ros1 or source.msgdef.format == MessageDefinitionFormat.NONE:
            raise BagError(f'{source.topic} cannot be copied: its type {source.msgtype} is not '
                           f'known here. {bag.describe()}')
        return self._writer.add_connection(
            source.topic, source.msgtype, msgdef=source.msgdef.data, rihs01=source.digest,
            offered_qos_profiles=qos)
