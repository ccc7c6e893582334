# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Recorded topics as the messages that a node would receive.

rosbag2 folders (sqlite3, mcap, compressed by zstd or not), single .mcap and .db3 files, and
ROS 1 .bag files, read by the library rosbags; no ROS installation is needed for any of them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from rclpy.serialization import deserialize_message
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection
from rosbags.typesys import Stores, get_typestore

FILE_SUFFIXES = ('.bag', '.mcap', '.db3')
# Reading continues this long after the message before the damage, then twice as long, and so on.
_FIRST_SKIP_NS = 1_000_000


class BagError(ValueError):
    """A bag cannot be read, or lacks required topics."""


class Topic(NamedTuple):
    """Name, type as in ``sensor_msgs/msg/Image``, and number of messages."""

    name: str
    msg_type: str
    count: int


class Recorded(NamedTuple):
    """A recorded message, with the time of its recording, serialised as in ROS 2."""

    topic: str
    time_ns: int
    cdr: bytes | memoryview


class BagReader:
    """
    An open bag, a rosbag2 folder or a .mcap, .db3 or ROS 1 .bag file; a context manager.

    ``damaged`` is the number of messages, or of unreadable sections, that were skipped.

    Raises
    ------
    FileNotFoundError
        There is no bag at this path.
    BagError
        It cannot be read.

    """

    def __init__(self, path: Path):
        self.path = path
        file = _storage(path)
        self.is_ros1 = file.suffix == '.bag'
        # ROS 1 messages use ROS 2's definitions; rosbags itself removes the seq of headers.
        self._types = get_typestore(Stores.ROS2_JAZZY)
        try:
            self._reader = (rosbag1 if self.is_ros1 else rosbag2).Reader(file)
            self._reader.open()
        except OSError:
            raise
        except Exception as error:  # damaged bytes may cause any exception in a parser
            raise self._unreadable(error) from error
        self.damaged = 0
        self._first: dict[str, Any] = {}
        self._connections: dict[str, list[Connection]] = {}
        for connection in self._reader.connections:
            self._connections.setdefault(connection.topic, []).append(connection)

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, *_: object) -> None:
        self._reader.close()

    @property
    def topics(self) -> tuple[Topic, ...]:
        """Recorded topics, sorted by name."""
        return tuple(Topic(name, connections[0].msgtype, sum(c.msgcount for c in connections))
                     for name, connections in sorted(self._connections.items()))

    @property
    def start_ns(self) -> int:
        """Time of the first message; 0 in an empty bag."""
        return self._reader.start_time if self._reader.message_count else 0

    @property
    def end_ns(self) -> int:
        """Time right after the last message; 0 in an empty bag."""
        return self._reader.end_time if self._reader.message_count else 0

    def describe(self) -> str:
        """Return the recorded topics as a readable table."""
        width = max((len(topic.name) for topic in self.topics), default=0)
        rows = [f'  {topic.name:<{width}}  {topic.msg_type}, {topic.count} messages'
                for topic in self.topics]
        return '\n'.join([f'{self.path} has {"these topics" if rows else "no topics"}:', *rows])

    def connection(self, topic: str) -> Connection:
        """Return the connection of a topic, as in rosbags."""
        return self._connections[topic][0]

    def read(self, topics: Collection[str], start_ns: int | None = None,
             stop_ns: int | None = None) -> Iterator[Recorded]:
        """
        Yield the messages of topics in the order of their recording, without damaged sections.

        Raises
        ------
        BagError
            The bag is damaged, and nothing after the damage can be read.

        """
        connections = [c for topic in topics for c in self._connections[topic]]
        last_ns = self.start_ns if start_ns is None else start_ns
        end_ns = self.end_ns if stop_ns is None else min(stop_ns, self.end_ns)
        skip_ns = _FIRST_SKIP_NS
        while connections:  # an empty list would mean all topics
            try:
                for connection, time_ns, data in self._reader.messages(
                        connections, start_ns, stop_ns):
                    last_ns, skip_ns = time_ns, _FIRST_SKIP_NS
                    if self.is_ros1:
                        data = self._types.ros1_to_cdr(data, connection.msgtype)
                    yield Recorded(connection.topic, time_ns, data)
                return
            except Exception as error:
                start_ns = last_ns + skip_ns
                if start_ns >= end_ns:
                    raise self._unreadable(error) from error
                self.damaged += skip_ns == _FIRST_SKIP_NS
                skip_ns *= 2

    def plain(self, recorded: Recorded) -> Any:
        """Return a message as an object of rosbags, of any type of ROS 2 Jazzy."""
        return self._types.deserialize_cdr(recorded.cdr, self.connection(recorded.topic).msgtype)

    def first(self, topic: str, message_class: Any) -> Any:
        """Return the first message of a topic that can be read, or None."""
        if topic not in self._first:
            self._first[topic] = None
            for recorded in self.read([topic]):
                with suppress(BagError):
                    self._first[topic] = to_message(recorded, message_class)
                    break
        return self._first[topic]

    def _unreadable(self, error: Exception) -> BagError:
        reason = ' '.join(str(error).split()).rstrip('.')
        return BagError(f'{self.path} cannot be read: {reason}. {_listing(self.path)} If it is '
                        f'damaged or was not closed, {_repair(self.path)} may help')


def to_message(recorded: Recorded, message_class: Any) -> Any:
    """Return the message that a subscription would receive; raise BagError if it is invalid."""
    try:
        return deserialize_message(bytes(recorded.cdr), message_class)
    except Exception as error:  # the middleware's own error class is not public
        raise BagError(f'a message on {recorded.topic} is not a {message_class.__name__}: '
                       f'{error}') from error


def bag_name(path: Path) -> str:
    """Return the name of a bag: of its folder, including dots, or its file without suffix."""
    return path.name if path.is_dir() else path.stem


def _storage(path: Path) -> Path:
    """Return the path for rosbags: the folder, or the only file of a folder without metadata."""
    if not path.exists():
        raise FileNotFoundError(f'there is no bag {path}')
    if not path.is_dir():
        if path.suffix not in FILE_SUFFIXES:
            raise BagError(f'{path} is not a bag: a bag is a rosbag2 folder or a file '
                           f'{", ".join(FILE_SUFFIXES)}')
        return path
    if (path / 'metadata.yaml').exists():
        return path
    files = [file for file in path.iterdir() if file.suffix in FILE_SUFFIXES]
    if len(files) == 1:  # a recording that was killed
        return files[0]
    raise BagError(f'{path} is not a bag: it has no metadata.yaml. {_listing(path)} For a folder '
                   'with several files, ros2 bag reindex recreates the metadata')


def _listing(path: Path) -> str:
    """Return a sentence that lists the files."""
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    named = ', '.join(f'{file.name} ({file.stat().st_size} bytes)' for file in files)
    return f'There is {named or "nothing in it"}.'


def _repair(path: Path) -> str:
    """Return the tools that repair the files of such a bag."""
    if path.suffix == '.bag':
        return 'rosbag reindex'
    is_mcap = path.suffix == '.mcap' or any(path.glob('*.mcap'))
    tool = 'mcap recover' if is_mcap else '.recover of sqlite3'
    return f'{tool}, or ros2 bag reindex for metadata.yaml alone,' if path.is_dir() else tool
