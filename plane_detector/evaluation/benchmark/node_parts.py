# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""CPU time of each part of the node's work on a frame: receiving, planes, each output."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import rclpy
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from plane_detector.config import Config, DepthConfig, NodeConfig
from plane_detector.evaluation.benchmark.node_load import input_messages
from plane_detector.evaluation.benchmark.node_receiver import RELIABLE, Receiver
from plane_detector.evaluation.benchmark.tables import emit, table
from plane_detector.evaluation.datasets import Frame as View
from plane_detector.pipeline import PlaneDetector
from plane_detector.ros.frame_processor import FrameProcessor
from plane_detector.ros.inputs.frame_conversion import FrameConverter
from plane_detector.ros.inputs.synchronizer import Frame
from plane_detector.ros.outputs.topics import OUTPUTS

HELD = 8
"""Each view is processed this many times in a row, so that labels are tracked."""
_TOPICS = 'plane_detector_parts'
_CONNECTION_S = 30.0


def report_parts(found: Sequence[tuple[str, DepthConfig]], views: Sequence[View]) -> None:
    """
    Print the time of each part of the work, without the node's threads, by source of depth.

    rclpy must be initialised: the outputs are published to a receiver in another process.
    """
    node = rclpy.create_node('plane_detector_parts')
    try:
        publishers = {name: node.create_publisher(output.msg_type, f'{_TOPICS}/{name}', RELIABLE)
                      for name, output in OUTPUTS.items()}
        with Receiver(tuple(OUTPUTS), _TOPICS):
            _wait_for(publishers)
            for name, depth in found:
                parts = _Parts(depth, publishers)
                for view in views:
                    for turn in range(1 + HELD):
                        parts.take(view, counts=turn > 0)
                _emit_parts(name, parts)
    finally:
        node.destroy_node()


def _wait_for(publishers: Mapping[str, Publisher]) -> None:
    deadline_s = time.monotonic() + _CONNECTION_S
    while not all(one.get_subscription_count() for one in publishers.values()):
        if time.monotonic() > deadline_s:
            raise RuntimeError(f'the receiver did not connect within {_CONNECTION_S:g} s')
        time.sleep(0.05)


class _Parts:
    """Processes views and records the CPU time of each part, in milliseconds."""

    def __init__(self, depth: DepthConfig, publishers: Mapping[str, Publisher]) -> None:
        self._processor = FrameProcessor(PlaneDetector(Config(depth=depth)), NodeConfig(), 'image')
        self._converter = FrameConverter('image')
        self._with_depth = depth.source == 'topic'
        self._publishers = publishers
        self.planes: list[int] = []
        self.size_mb: dict[str, float] = {}
        self.ms: defaultdict[str, list[float]] = defaultdict(list)

    def take(self, view: View, counts: bool) -> None:
        """Process a view; the first time, which fills caches, is not counted."""
        ms: dict[str, float] = {}
        sent = input_messages(Header(), view)
        names = ('image', 'depth') if self._with_depth else ('image',)
        taken = [serialize_message(sent[name]) for name in names]
        received = _timed(ms, 'taking the images', lambda: [
            deserialize_message(data, Image) for data in taken])
        frame = Frame(received[0], sent['camera_info'], received[1] if self._with_depth else None,
                      gravity_camera=None, epoch=0)
        settings = self._processor.settings
        _timed(ms, 'conversion', lambda: self._converter.convert(frame, settings))
        result = _timed(ms, 'depth and planes', lambda: self._processor.process(frame, ())).result
        ms['depth and planes'] -= ms['conversion']
        for name, output in OUTPUTS.items():
            msg = _timed(ms, f'making {name}', lambda make=output.make: make(result))
            if msg is not None:
                _timed(ms, f'publishing {name}',
                       lambda name=name, msg=msg: self._publishers[name].publish(msg))
                data = msg if isinstance(msg, bytes) else serialize_message(msg)
                self.size_mb[name] = len(data) / 1e6
        if counts:
            self.planes.append(len(result.detection.planes))
            for part, one in ms.items():
                self.ms[part].append(one)


def _timed(ms: dict[str, float], part: str, work: Callable[[], Any]) -> Any:
    """Return the result of the work; record the CPU time of all threads of this process."""
    start_s = time.process_time()
    done = work()
    ms[part] = 1e3 * (time.process_time() - start_s)
    return done


def _emit_parts(name: str, parts: _Parts) -> None:
    ms = {part: float(np.median(values)) for part, values in parts.ms.items()}
    rows = [[part, f'{ms[part]:.2f}', '', '']
            for part in ('taking the images', 'conversion', 'depth and planes')]
    rows += [[f'~/{output}', f'{ms[f"making {output}"]:.2f}', f'{ms[f"publishing {output}"]:.2f}',
              f'{size_mb:.3f}'] for output, size_mb in parts.size_mb.items()]
    made, published = (sum(value for part, value in ms.items() if part.startswith(kind))
                       for kind in ('making', 'publishing'))
    rows.append(['all outputs', f'{made:.2f}', f'{published:.2f}',
                 f'{sum(parts.size_mb.values()):.3f}'])
    emit(f'### Time on a core by part, {name}, median of {np.median(parts.planes):.0f} planes',
         table(('part', 'time (ms)', 'publishing (ms)', 'size (MB)'), rows),
         'All threads of one process, medians. Planes: segmentation, scale, measurement, '
         'tracking. What outputs share, as outlines and the overlay, is in the first '
         'one that needs it. Publishing: the call, and what other threads of the middleware do '
         'meanwhile.')
