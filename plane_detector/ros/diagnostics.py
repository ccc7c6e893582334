# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Diagnostics of the node: counts and times, one level and one sentence, a table of planes.

A sentence is logged too when it changes, and names the remedy.
"""

from __future__ import annotations

import math
import re
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from plane_detector._runtime.compilation import are_ready
from plane_detector.ros.outputs.frame import DetectedFrame
from plane_detector.ros.outputs.markers import plane_name
from plane_detector.ros.qos import SILENT_PUBLISHER, overriding_options
from plane_detector.types import OBSTACLE_DISTANCES_M, Detection, GroundLack

HARDWARE_ID = 'plane_detector'
"""Hardware id of all statuses of this package; viewers group statuses by it."""
PLANES_ID = 'plane_detector planes'
"""Hardware id of the table of planes, which gets its own panel whatever the name of the node."""
_PERIOD_S = 1.0
# chosen: a network uses at most about 500 pixels on its short side; more than four times that
# only costs time in the other stages.
LARGE_PX = 2500
REDUCED_PX = 1280
"""Recommended longer side for larger images."""
# By contract: a camera that is not mounted as stated is reported if that lasts.
_MISPLACED_S = 5.0
# chosen: gravity is often found in the second image; a warning that the next line withdraws is
# useless.
_PATIENT_IMAGES = 3
_NUMBER = re.compile(r'-?\d+(\.\d+)?')
# Smaller differences are due to the clocks.
_TOLERANCE = 1.1
POINTS_WITHOUT_FLOOR, DROPS = 'points_without_floor', 'drops'
GRAVITY_SOURCES = 'scale.gravity, use_imu with an IMU, or base_frame'


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

    def add_processed(self, stage_seconds: Mapping[str, float], frame: DetectedFrame) -> None:
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


class Health:
    """
    Collects problems. The worker thread calls `note`, the executor's thread everything else.

    There is no lock: attributes are replaced as a whole, `_warned` only grows between two calls of
    `clear`, and a status may mix two frames.

    Attributes
    ----------
    failure : str
        Why the node could not be configured or activated; empty if it could.
    may_pass : bool
        Whether the cause may be temporary, such as an unreachable host.
    late_failure : str
        Why the kernels of ground, obstacles and drops could not be compiled; empty if they could.

    """

    def __init__(self, logger: Any):
        self._logger = logger
        self.failure = ''
        self.may_pass = False
        self.late_failure = ''
        self.clear()

    def clear(self) -> None:
        """Discard the state of earlier frames: missing inputs are logged again."""
        self._gap, self._gap_images = '', 0
        self._misplaced_s, self._misplaced = math.nan, ''
        self._warned: set[str] = set()
        self._last_warned: dict[str, str] = {}
        self._last: Detection | None = None

    @property
    def facts(self) -> dict[str, str]:
        """Facts from the last frame: source of the unit, source of gravity."""
        return _facts_of(self._last, self.late_failure) if self._last is not None else {}

    def note(self, detection: Detection, wanted: Collection[str], stamp_s: float = 0.0) -> None:
        """
        Note the result of a frame.

        ``wanted`` are the outputs that have subscribers, ``stamp_s`` the time of the image.
        """
        self._last, mounting = detection, detection.ground_result.mounting
        self._note_mounting(mounting.problem if mounting else '', stamp_s)
        if detection.input_note:  # once, however its numbers vary
            self.warn_once(_NUMBER.sub('', detection.input_note), detection.input_note)
        if detection.scale_event:
            self._logger.info(detection.scale_event)
        if detection.constant_note:
            self.warn_once(_NUMBER.sub('', detection.constant_note), detection.constant_note)
        before, self._gap = self._gap, missing_for_classes(detection, wanted)
        if self._gap:  # numbers in it vary from frame to frame
            self._gap_images += 1
            if self._gap_images >= _PATIENT_IMAGES:
                self.warn_once(_NUMBER.sub('', self._gap), self._gap)
        elif before:
            self._note_filled(before, detection)
            self._gap_images = 0

    def _note_filled(self, gap: str, detection: Detection) -> None:
        """Log once what is now known, if its absence caused a warning or the image provided it."""
        is_in_image = 'gravity' in gap and not math.isnan(detection.gravity.probability)
        if self._gap_images < _PATIENT_IMAGES and not is_in_image:
            return
        filled = (f'gravity found in the image, probability {detection.gravity.probability:.2f}'
                  if is_in_image else f'gravity known: {detection.gravity.source}'
                  if 'gravity' in gap else gap.partition(':')[0].replace('is silent', 'is back'))
        if (key := _NUMBER.sub('', filled)) not in self._warned:
            self._warned.add(key)
            self._logger.info(filled)

    def _note_mounting(self, problem: str, stamp_s: float) -> None:
        """Warn of a camera that is not mounted as stated, if it lasts."""
        if not problem:
            self._misplaced_s, self._misplaced = math.nan, ''
        elif not stamp_s - self._misplaced_s >= 0:  # also the first time
            self._misplaced_s = stamp_s
        elif stamp_s - self._misplaced_s >= _MISPLACED_S:
            self._misplaced = f'{problem}: check scale.camera_height, scale.gravity or base_frame'
            self.warn_once('misplaced', self._misplaced)

    def warn_once(self, key: str, warning: str) -> None:
        """Log a warning whose wording may vary, but only once per key."""
        if key not in self._warned:
            self._warned.add(key)
            self._logger.warning(warning)

    def warn_of_changes(self, key: str, warning: str) -> None:
        """Log a warning when its wording changes, and again after it was empty."""
        if warning and self._last_warned.get(key) != warning:
            self._logger.warning(warning)
        self._last_warned[key] = warning

    def status(self, report: Report, silence: str, is_idle: bool = False) -> tuple[bytes, str]:
        """
        Return level and message of an active node.

        ``silence`` names a silent or incomplete input and the reason; a node without subscribers
        ``is_idle``, and processes no frame.
        """
        skipped = f'frames skipped: {report.last_error}' if report.skipped_lately else ''
        if skipped or silence:  # a silent IMU does not hide that images give nothing
            return DiagnosticStatus.WARN, '; '.join(filter(None, (skipped, silence)))
        if is_idle:
            return DiagnosticStatus.OK, 'idle: nobody listens to an output'
        if self._gap or self._misplaced:
            return DiagnosticStatus.WARN, '; '.join(filter(None, (self._gap, self._misplaced)))
        return DiagnosticStatus.OK, 'active'


def _facts_of(detection: Detection, late_failure: str) -> dict[str, str]:
    """Return the facts of a frame for the diagnostics."""
    facts = {'scale': detection.scale.unit_method, 'scale_note': str(detection.scale),
             'gravity': detection.gravity.source}
    if detection.scale.is_metric:
        facts['noise'] = (f'{detection.disparity_noise:.4f} 1/m, of which '
                          f'{detection.systematic_noise:.4f} bend planes')
    if detection.input_note:
        facts['input_note'] = detection.input_note
    if detection.plane_note:
        facts['planes_dropped'] = detection.plane_note
    if detection.constant_note:
        facts['constant_depth'] = detection.constant_note
    if detection.gravity.note:
        facts['gravity_note'] = detection.gravity.note
    if detection.gravity.probability == detection.gravity.probability:  # not NaN
        facts['gravity_probability'] = f'{detection.gravity.probability:.2f}'
    if detection.camera_height_m == detection.camera_height_m:
        facts['camera_height_m'] = f'{detection.camera_height_m:.3f}'
    if detection.tilt_deg == detection.tilt_deg:
        facts['camera_tilt_deg'] = f'{detection.tilt_deg:.1f}'
    if (mounting := detection.ground_result.mounting) is not None:
        facts['mounting'] = ', '.join(
            f'{name} {stated:.{digits}f} {unit} stated, {seen:.{digits}f} measured'
            for name, stated, seen, unit, digits in (
                ('height', mounting.stated_height_m, mounting.height_m, 'm', 3),
                ('tilt', mounting.stated_tilt_deg, mounting.tilt_deg, 'degrees', 1))
            if stated == stated)  # not NaN
    if (smallest_m := detection.ground_result.smallest_obstacles_m).size:
        facts['smallest_obstacle_m'] = ', '.join(
            f'{height_m:.3f} at {ahead_m:g} m'
            for ahead_m, height_m in zip(OBSTACLE_DISTANCES_M, smallest_m, strict=True))
    facts['drops'] = _drops_of(detection, late_failure)
    facts['shapes'] = (f'not searched for: {detection.shape_note}' if detection.shape_note
                       else str(len(detection.shapes)))
    return facts


def _drops_of(detection: Detection, late_failure: str) -> str:
    """Return what is known about drops; they are computed when first read."""
    found = detection.ground_result
    if found.is_known and not are_ready('ground_pixels'):
        return ('not counted: their kernels are being compiled' if not late_failure else
                f'not counted, their kernels cannot be compiled ({late_failure}): restart the '
                'node; if that fails too, install numba anew')
    if found.drop_note and not found.edge_note:
        return f'not searched for: {found.drop_note}'
    points = f'{len(found.drops_m)} points'
    return f'{points}; unknown: {found.edge_note}' if found.edge_note else points


def missing_for_classes(detection: Detection, wanted: Collection[str]) -> str:
    """
    Return what a frame lacks for classes, obstacles and drops, and the remedy; empty if nothing.

    ``wanted`` are the names of the outputs that have subscribers.
    """
    found = detection.ground_result
    if found.is_known:
        is_silent = DROPS in wanted and found.drop_note
        return f'~/{DROPS} is silent: {found.drop_note}' if is_silent else ''
    lost, is_relative = POINTS_WITHOUT_FLOOR in wanted, not detection.scale.is_metric
    silent = f'~/{POINTS_WITHOUT_FLOOR} is silent'
    if found.lack is not GroundLack.GRAVITY:
        why = f' ({detection.scale})' if is_relative else ''
        return f'{silent}: {found.drop_note}{why}' if lost else ''
    if detection.planes:
        silent = 'planes have no class' + (f', and {silent}' if lost else '')
    elif not lost:
        return ''
    if is_relative:
        return (f'{silent}: neither metres nor gravity are known; give scale.camera_height and '
                f'{GRAVITY_SOURCES}')
    by_image = f' ({detection.gravity.note})' if detection.gravity.note else ''
    return f'{silent}: the direction of gravity is not known{by_image}; give {GRAVITY_SOURCES}'


def slow_network(report: Report, network_input: str) -> str:
    """Return a message if the network takes longer than the period of the camera, else nothing."""
    depth_s = report.stage_seconds.get('depth', 0.0)
    if not network_input or depth_s * report.arrival_hz <= _TOLERANCE:
        return ''
    return (f'the network takes {1e3 * depth_s:.0f} ms for an input of {network_input}, the '
            f'camera sends an image every {1e3 / report.arrival_hz:.0f} ms: set a smaller '
            'depth.short_side (half takes a quarter) or fewer depth.views, or use a smaller '
            'network or a GPU')


def large_image(report: Report) -> str:
    """Return advice if images are larger than is useful for finding planes, else nothing."""
    if report.last is None or max(report.last.detection.labels.shape) <= LARGE_PX:
        return ''
    height, width = report.last.detection.labels.shape
    return (f'an image of {width} x {height} takes {1e3 * sum(report.stage_seconds.values()):.0f} '
            f'ms: set max_side to {REDUCED_PX} to reduce it first')


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
                                                event_callbacks=SILENT_PUBLISHER,
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
    Return the log lines of the configuration: source of depth and its reason, inputs and outputs.

    ``facts`` are of the source of depth, ``topics`` of the inputs, ``planes`` is an output.
    """
    runs_on = facts.get('execution_provider')
    lines = [f'depth from {facts["depth_model"]}' + (f', {runs_on}' if runs_on else ''),
             facts.get('depth_model_reason', ''),
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
    Return the planes of a frame as a table: their number, then one row per plane.

    ``planes_in_all`` is their number in all frames so far.
    """
    detection = frame.detection
    rows = {'planes': str(len(detection.planes))}
    if planes_in_all is not None:
        rows['planes_in_all'] = str(planes_in_all)
    is_metric = detection.scale.is_metric
    unit = ' m' if is_metric else ''
    for plane, rectangle in zip(detection.planes, frame.rectangles, strict=True):
        sides = f'{rectangle.width_m:.2f} x {rectangle.height_m:.2f}{unit}'
        rms = f'{1e3 * plane.rms_m:.0f} mm' if is_metric else f'{plane.rms_m:.3f}'
        rows[plane_name(plane)] = (
            f'{plane.offset_m:.2f}{unit}, {sides}, rms {rms}, {100 * plane.confidence:.0f} %')
    return DiagnosticStatus(name=f'{name}: planes', level=DiagnosticStatus.OK,
                            message=f'{rows["planes"]} planes', hardware_id=PLANES_ID,
                            values=[KeyValue(key=k, value=v) for k, v in rows.items()])
