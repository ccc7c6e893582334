# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Bags for the tests, written by rosbags itself in each of its formats, and read back."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import needs_rosbags  # noqa: F401
from rclpy.serialization import deserialize_message, serialize_message
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

FORMATS = {
    'mcap': (StoragePlugin.MCAP, CompressionMode.NONE),
    'mcap_zstd_chunks': (StoragePlugin.MCAP, CompressionMode.STORAGE),
    'sqlite3': (StoragePlugin.SQLITE3, CompressionMode.NONE),
    'sqlite3_zstd_messages': (StoragePlugin.SQLITE3, CompressionMode.MESSAGE)}
ROS1 = 'ros1.bag'
CUSTOM_TYPE = 'robot_msgs/msg/Bumper'


def write_bag(path: Path, messages: list[tuple[str, int, Any]], bag_format: str = 'mcap') -> Path:
    """
    Write (topic, time of recording in ns, message): of ROS or of rosbags, a str as `CUSTOM_TYPE`.

    Bytes are written as they are, after another message of their topic.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg('string text', CUSTOM_TYPE))
    if bag_format == ROS1:
        writer, types = rosbag1.Writer(path), get_typestore(Stores.ROS1_NOETIC)
    else:
        plugin, mode = FORMATS[bag_format]
        writer, types = rosbag2.Writer(path, version=9, storage_plugin=plugin), store
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for topic, time_ns, msg in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, _type_of(msg), typestore=types)
            data = _cdr(store, msg)
            if bag_format == ROS1:
                data = bytes(store.cdr_to_ros1(data, connections[topic].msgtype))
            writer.write(connections[topic], time_ns, data)
    return path


def read_bag(path: Path) -> dict[str, list[tuple[int, bytes]]]:
    """Return (time of recording in ns, bytes) of all messages by topic."""
    result = defaultdict(list)
    with rosbag2.Reader(path) as reader:
        for connection, time_ns, data in reader.messages():
            result[connection.topic].append((time_ns, bytes(data)))
        assert reader.message_count == sum(map(len, result.values()))
    return dict(result)


def messages_of(path: Path, topic: str, message_class: Any) -> list[Any]:
    """Return the messages of a topic of a rosbag2."""
    return [deserialize_message(data, message_class) for _, data in read_bag(path)[topic]]


def _type_of(msg: Any) -> str:
    if isinstance(msg, str):
        return CUSTOM_TYPE
    if kind := getattr(msg, '__msgtype__', ''):
        return kind
    return f'{type(msg).__module__.split(".")[0]}/msg/{type(msg).__name__}'


def _cdr(store: Any, msg: Any) -> bytes:
    if isinstance(msg, str):
        msg = store.types[CUSTOM_TYPE](text=msg)
    if isinstance(msg, bytes):
        return msg
    if kind := getattr(msg, '__msgtype__', ''):
        return bytes(store.serialize_cdr(msg, kind))
    return serialize_message(msg)
