# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Outputs of a replay: a rosbag2, which `ros2 bag`, RViz and Foxglove open, a figure and a cloud of
each frame, tables of all frames. Files and folders get their names when they are complete.
"""

from __future__ import annotations

import csv
import fcntl
import os
import shutil
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any, TextIO

import cv2
import numpy as np
import yaml
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
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from plane_detector import drawing
from plane_detector.geometry.projection import depth_to_points
from plane_detector.planes.plane_table import PLANE_DTYPE
from plane_detector.ros.inputs.synchronizer import stamp_text
from plane_detector.ros.outputs.clouds import SHAPE_DTYPE
from plane_detector.ros.outputs.frame import DetectedFrame
from plane_detector.tools.files import csv_head, csv_row, depth_panel, write_ply
from plane_detector.tools.replay.bag_reader import BagError, BagReader, Recorded

STORAGES = {'mcap': StoragePlugin.MCAP, 'sqlite3': StoragePlugin.SQLITE3}
# Chunks of an mcap file are compressed inside the file; sqlite3 has no chunks.
_COMPRESSIONS = {'mcap': CompressionMode.STORAGE, 'sqlite3': CompressionMode.MESSAGE}
# Contents of the rows of a table, by output.
_ROWS = {'planes': PLANE_DTYPE, 'shapes': SHAPE_DTYPE}
_FOREVER = QosTime(9223372036, 854775807)
# `ros2 bag play` offers the QoS stated in the bag, and volatile if there is none: RViz, which
# requests the last message of a latched topic, would never get one.
_LATCHED = [Qos(QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL,
                _FOREVER, _FOREVER, QosLiveliness.AUTOMATIC, _FOREVER, False)]
# The last version whose quality of service can be read by rosbag2 before Jazzy.
_VERSION = 8


class AtomicOutput:
    """
    A file or folder that gets its name when it is complete; a context manager.

    TARGET is written to `path`, .TARGET.part/TARGET. The remains of a killed process are replaced
    by the next process that writes TARGET. BlockingIOError is raised if another process is writing
    it.
    """

    def __init__(self, target: Path):
        self._target, self._folder = target, part_folder(target)
        self.path = self._folder / target.name

    def __enter__(self) -> AtomicOutput:
        self._folder.mkdir(parents=True, exist_ok=True)
        # A file, because NFS does not lock folders.
        self._lock = open(self._folder / 'lock', 'w', encoding='ascii')
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            self._lock.close()
            raise BlockingIOError(f'{self._target} is being written by another process'
                                  ) from error
        shutil.rmtree(self.path, ignore_errors=True)
        return self

    def __exit__(self, *_: object) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)
        self._lock.close()

    def publish(self, prefix: str = '') -> Path:
        """Give it its name; with a prefix if it was interrupted, then replacing an earlier one."""
        target = self._target.with_name(prefix + self._target.name)
        if prefix and replay_fields(target):
            shutil.rmtree(target)
        os.replace(self.path, target)
        return target


def part_folder(target: Path) -> Path:
    """Return the folder for writing a target: only a killed process leaves it behind."""
    return target.with_name(f'.{target.name}.part')


def replay_fields(bag: Path) -> dict[str, str]:
    """Return the fields that a replay wrote into the metadata of its bag; empty for other bags."""
    try:
        with open(bag / 'metadata.yaml', encoding='utf-8') as file:
            found = yaml.safe_load(file)['rosbag2_bagfile_information']['custom_data']
    except (OSError, yaml.YAMLError, KeyError, TypeError):
        return {}
    return found if isinstance(found, dict) and 'replay.state' in found else {}


class BagWriter:
    """
    A new rosbag2 of format ``mcap`` or ``sqlite3``, compressed by zstd or not; a context manager.

    Its methods raise OSError if the bag cannot be written.
    """

    def __init__(self, path: Path, storage: str, compressed: bool):
        self._types = get_typestore(Stores.ROS2_JAZZY)
        self._writer = Writer(path, version=_VERSION, storage_plugin=STORAGES[storage])
        if compressed:
            self._writer.set_compression(_COMPRESSIONS[storage], CompressionFormat.ZSTD)
        self._connections: dict[str, Connection] = {}

    def __enter__(self) -> BagWriter:
        self._writer.open()
        return self

    def __exit__(self, *error: Any) -> None:
        with self._writable():
            self._writer.__exit__(*error)

    def describe(self, values: Mapping[str, str]) -> None:
        """Put names and values into the metadata, which `ros2 bag info` shows."""
        for name, value in values.items():
            self._writer.set_custom_data(name, value)

    def add_outputs(self, classes: Mapping[str, Any], are_latched: bool = False) -> None:
        """Announce topics whose messages are of these classes."""
        for topic, message_class in classes.items():
            package, kind = message_class.__module__.split('.')[0], message_class.__name__
            self._connections[topic] = self._writer.add_connection(
                topic, f'{package}/msg/{kind}', typestore=self._types,
                offered_qos_profiles=_LATCHED if are_latched else [])

    def add_copies(self, bag: BagReader, topics: tuple[str, ...]) -> None:
        """Announce topics of another bag; raise BagError if there is no such topic or type."""
        recorded = {topic.name for topic in bag.topics}
        for topic in topics:
            if topic not in recorded:
                raise BagError(f'there is no topic {topic}, as given by --copy. {bag.describe()}')
            if topic not in self._connections:  # diagnostics of both share a topic
                self._connections[topic] = self._copied(bag, bag.connection(topic))

    def write(self, topic: str, time_ns: int, msg: Any) -> None:
        """Write a message; equal messages give equal bytes."""
        kind = self._connections[topic].msgtype
        # The middleware leaves padding between fields uninitialised; rosbags writes zeros.
        plain = self._types.deserialize_cdr(serialize_message(msg), kind)
        with self._writable():
            self._writer.write(self._connections[topic], time_ns,
                               self._types.serialize_cdr(plain, kind))

    def write_static_transforms(self, time_ns: int, transforms: Sequence[Any]) -> None:
        """Write geometry_msgs/TransformStamped on /tf_static; tf2_msgs need not be installed."""
        kind = 'tf2_msgs/msg/TFMessage'
        self._connections['/tf_static'] = self._writer.add_connection(
            '/tf_static', kind, typestore=self._types, offered_qos_profiles=_LATCHED)
        plain = [self._types.deserialize_cdr(serialize_message(one),
                                             'geometry_msgs/msg/TransformStamped')
                 for one in transforms]
        with self._writable():
            self._writer.write(self._connections['/tf_static'], time_ns,
                               self._types.serialize_cdr(self._types.types[kind](plain), kind))

    def copy(self, recorded: Recorded) -> None:
        """Write a recorded message of an announced topic."""
        with self._writable():
            self._writer.write(self._connections[recorded.topic], recorded.time_ns, recorded.cdr)

    @contextmanager
    def _writable(self) -> Iterator[None]:
        """Name the bag in an error of its storage, such as a full disk."""
        try:
            yield
        except (OSError, sqlite3.Error) as error:
            raise OSError(f'{self._writer.path.name} cannot be written: {error}') from error

    def _copied(self, bag: BagReader, source: Connection) -> Connection:
        qos = [] if bag.is_ros1 else source.ext.offered_qos_profiles
        if not qos and source.topic.endswith('/tf_static'):
            qos = _LATCHED
        if source.msgtype in self._types.fielddefs:
            return self._writer.add_connection(source.topic, source.msgtype,
                                               typestore=self._types, offered_qos_profiles=qos)
        if bag.is_ros1 or source.msgdef.format == MessageDefinitionFormat.NONE:
            raise BagError(f'{source.topic} cannot be copied: its type {source.msgtype} is '
                           f'unknown here. {bag.describe()}')
        return self._writer.add_connection(
            source.topic, source.msgtype, msgdef=source.msgdef.data, rihs01=source.digest,
            offered_qos_profiles=qos)


class ReplayFiles:
    """
    Writes a figure, a labelled cloud and rows of tables for each frame; a context manager.

    Folders of figures (.jpg) and clouds are created if needed. The CSV table of all planes of all
    frames, and ``<stem>_shapes.csv`` of all shapes if these are wanted, get their names by
    :meth:`publish`. OSError is raised at once if a folder, a table or the file of the map, which
    is written elsewhere, cannot be written.
    """

    def __init__(self, figures: Path | None, ply: Path | None, table: Path | None, shapes: bool,
                 map_file: Path | None = None):
        self._figures, self._ply, self._map_file = figures, ply, map_file
        self._paths = {} if table is None else {'planes': table}
        if table is not None and shapes:
            self._paths['shapes'] = table.with_name(f'{table.stem}_shapes.csv')
        self._tables: dict[str, tuple[AtomicOutput, TextIO]] = {}
        self._opened = ExitStack()

    def __enter__(self) -> ReplayFiles:
        # Everything is checked now: a failure at the end would cost hours of work.
        for path in filter(None, (*self._paths.values(), self._map_file)):
            if path.is_dir():
                raise IsADirectoryError(f'{path} is a folder: name a file')
        beside_map = self._map_file and self._map_file.parent
        for folder in filter(None, (self._figures, self._ply, beside_map)):
            folder.mkdir(parents=True, exist_ok=True)
            with NamedTemporaryFile(dir=folder):
                pass
        for name, path in self._paths.items():
            draft = self._opened.enter_context(AtomicOutput(path))
            file = self._opened.enter_context(
                open(draft.path, 'w', newline='', encoding='utf-8'))
            csv.writer(file).writerow(['frame', 'stamp', *csv_head(_ROWS[name])])
            self._tables[name] = draft, file
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def publish(self, prefix: str = '') -> None:
        """Give the tables their names, see :class:`AtomicOutput`."""
        for draft, file in self._tables.values():
            file.flush()
            draft.publish(prefix)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs that these files are made from."""
        return tuple(self._paths)

    def write(self, index: int, result: DetectedFrame, messages: Mapping[str, Any]) -> None:
        """Write the files of a frame, whose number is in their names."""
        if self._figures is not None:
            bgr = cv2.cvtColor(_figure(result), cv2.COLOR_RGB2BGR)
            with _whole(self._figures / f'{index:06d}.jpg') as path:
                if not cv2.imwrite(str(path), bgr):
                    raise OSError(f'{path} cannot be written')
        if self._ply is not None:
            points_m = depth_to_points(result.detection.depth_m, result.intrinsics)
            with _whole(self._ply / f'{index:06d}.ply') as path:
                tinted = drawing.tint(result.rgb, result.labels, result.colours)
                write_ply(path, points_m, tinted, result.labels,
                          in_metres=result.detection.scale.is_metric)
        for name, (_, file) in self._tables.items():
            if name not in messages:  # its pose is unknown
                continue
            csv.writer(file).writerows(
                [index, stamp_text(result), *csv_row(fields)]
                for fields in np.frombuffer(messages[name].data, _ROWS[name]))


@contextmanager
def _whole(path: Path) -> Iterator[Path]:
    """Yield the path to which a file is written before it gets its name."""
    draft = path.with_name(f'.{path.name}')
    yield draft
    os.replace(draft, path)


def _figure(result: DetectedFrame) -> np.ndarray:
    """Return image, depth and planes side by side."""
    detection = result.detection
    unit = 'm' if detection.scale.is_metric else 'units'
    return drawing.figure([
        (f'image of {stamp_text(result)}', result.rgb),
        depth_panel('depth', detection.depth_m, unit),
        (f'{len(detection.planes)} planes', result.overlay),
    ], columns=3)
