# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of the node: rate, latency per stage, drops, the network, the last error."""

from __future__ import annotations

import threading
import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from plane_detector.ros.outputs.frame import DetectedFrame
from plane_detector.ros.outputs.markers import plane_name
from plane_detector.ros.outputs.messages import plane_labels
from plane_detector.ros.qos import overriding_options
from plane_detector.scale.estimate import RELATIVE

HARDWARE_ID = 'plane_detector'
"""Hardware id of all statuses of this package, by which viewers group them."""
PLANES_ID = 'plane_detector planes'
"""Hardware id of the table of planes: a panel of its own, whatever the name of the node."""
_PERIOD_S = 1.0


@dataclass(frozen=True)
class Report:
    """Events since the last report, and totals."""

    processed: int  # frames, in total
    dropped: int  # in total: replaced by a newer one, or without partner
    skipped: int  # in total: unusable
    rate_hz: float  # of processed frames, since the last report
    stage_seconds: Mapping[str, float] = field(default_factory=dict)  # mean since the last report
    skipped_lately: bool = False  # since the last report, as all that follows
    unpaired_lately: bool = False
    last_error: str = ''  # ever
    arrival_hz: float = 0.0
    error_age_s: float = 0.0
    last: DetectedFrame | None = None


class Statistics:
    """Counts frames and sums times; thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._processed = self._dropped = self._skipped = 0
        self._last_error, self._error_s = '', 0.0
        self._start_window()

    def add_processed(self, stage_seconds: Mapping[str, float],
                      frame: DetectedFrame | None = None) -> None:
        """Count a processed frame."""
        with self._lock:
            self._last = frame
            self._processed += 1
            self._window_processed += 1
            for stage, seconds in stage_seconds.items():
                self._window_seconds[stage] += seconds

    def add_dropped(self, count: int) -> None:
        """Count frames that were dropped unprocessed."""
        with self._lock:
            self._dropped += count
            self._window_dropped += count

    def add_unpaired(self, count: int) -> None:
        """Count images dropped because their calibration or depth did not arrive."""
        with self._lock:
            self._dropped += count
            self._window_unpaired += count

    def add_skipped(self, error: str) -> None:
        """Count a frame that could not be processed."""
        with self._lock:
            self._skipped += 1
            self._window_skipped += 1
            self._note_error(error)

    def set_error(self, error: str) -> None:
        """Store an error that does not belong to a frame."""
        with self._lock:
            self._note_error(error)

    def report(self) -> Report:
        """Return the report, and reset the counts since the last one."""
        with self._lock:
            now_s = time.monotonic()
            elapsed_s = max(now_s - self._window_start_s, 1e-9)
            count = self._window_processed
            result = Report(
                self._processed, self._dropped, self._skipped, count / elapsed_s,
                {stage: seconds / count for stage, seconds in self._window_seconds.items()},
                self._window_skipped > 0, self._window_unpaired > 0, self._last_error,
                (count + self._window_dropped + self._window_skipped) / elapsed_s,
                now_s - self._error_s, self._last)
            self._start_window()
            return result

    def _note_error(self, error: str) -> None:
        self._last_error, self._error_s = error, time.monotonic()

    def _start_window(self) -> None:
        self._window_start_s = time.monotonic()
        self._window_processed = self._window_skipped = self._window_unpaired = 0
        self._window_dropped = 0
        self._last: DetectedFrame | None = None
        self._window_seconds: defaultdict[str, float] = defaultdict(float)


class DiagnosticsPublisher:
    """
    Publishes the state of the node on /diagnostics once a second, in every lifecycle state.

    ``describe`` returns level, message and facts for a report. The period is by the steady clock,
    so that diagnostics are published even if simulation time stands still.
    """

    def __init__(self, node: Node, statistics: Statistics,
                 describe: Callable[[Report], tuple[bytes, str, Mapping[str, str]]]):
        self._node = node
        self._statistics = statistics
        self._describe = describe
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10,
                                                qos_overriding_options=overriding_options())
        self._timer = node.create_timer(_PERIOD_S, self._publish,
                                        clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _publish(self) -> None:
        report = self._statistics.report()
        level, message, facts = self._describe(report)
        msg = DiagnosticArray()
        msg.header.stamp = self._node.get_clock().now().to_msg()
        name = self._node.get_fully_qualified_name().lstrip('/')
        msg.status = [status_to_msg(name, level, message, report, facts)]
        if report.last is not None:
            msg.status.append(planes_status(name, report.last))
        self._publisher.publish(msg)


def introduction(facts: Mapping[str, str], topics: Mapping[str, str], planes: str) -> list[str]:
    """
    Return the log lines at configure: source of depth and its reason, inputs and outputs.

    ``facts`` are of the source of depth, ``topics`` of the inputs, ``planes`` is an output.
    """
    runs_on = facts.get('execution_provider')
    lines = [f'depth from {facts["depth_model"]}' + (f', {runs_on}' if runs_on else ''),
             facts.get('depth_model_reason', ''), facts.get('network_input_reason', ''),
             f'{topics["image"]}, {topics["camera_info"]} -> {planes} and the other outputs']
    return [line for line in lines if line]


def status_to_msg(name: str, level: bytes, message: str, report: Report,
                  facts: Mapping[str, str]) -> DiagnosticStatus:
    """Return the status of the node; facts come first, without the empty ones."""
    values = {key: value for key, value in facts.items() if value}
    values['rate_hz'] = f'{report.rate_hz:.2f}'
    for stage, seconds in report.stage_seconds.items():
        values[f'latency.{stage}_ms'] = f'{seconds * 1e3:.2f}'
    values['latency.total_ms'] = f'{sum(report.stage_seconds.values()) * 1e3:.2f}'
    values['frames_processed'] = str(report.processed)
    values['frames_dropped'] = str(report.dropped)
    values['frames_skipped'] = str(report.skipped)
    if report.last_error:  # it stays after the node has recovered
        values['last_error'] = report.last_error
        values['last_error_age_s'] = f'{report.error_age_s:.1f}'
    return DiagnosticStatus(name=name, level=level, message=message, hardware_id=HARDWARE_ID,
                            values=[KeyValue(key=k, value=v) for k, v in values.items()])


def planes_status(name: str, frame: DetectedFrame,
                  planes_in_all: int | None = None) -> DiagnosticStatus:
    """
    Return the planes of a frame as a table: their number, then one row a plane.

    ``planes_in_all`` is their number in all frames so far.
    """
    detection, labels = frame.detection, plane_labels(frame.detection).tolist()
    rows = {'planes': str(len(labels))}
    if planes_in_all is not None:
        rows['planes_in_all'] = str(planes_in_all)
    is_metric = detection.scale_method != RELATIVE
    unit = ' m' if is_metric else ''
    for index, (plane, label, rectangle) in enumerate(zip(detection.planes, labels,
                                                          frame.rectangles, strict=True)):
        sides = f'{rectangle.width_m:.2f} x {rectangle.height_m:.2f}{unit}'
        rms = f'{1e3 * plane.rms_m:.0f} mm' if is_metric else f'{plane.rms_m:.3f}'
        rows[plane_name(detection, index, label)] = (
            f'{plane.offset_m:.2f}{unit}, {sides}, rms {rms}, {100 * plane.confidence:.0f} %')
    return DiagnosticStatus(name=f'{name}: planes', level=DiagnosticStatus.OK,
                            message=f'{len(labels)} planes', hardware_id=PLANES_ID,
                            values=[KeyValue(key=k, value=v) for k, v in rows.items()])
