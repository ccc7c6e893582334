# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Health of the node: one level and one sentence, and a log line when it changes."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from plane_detector.ros.diagnostics import Report
from plane_detector.scale.estimate import RELATIVE
from plane_detector.types import Detection

# derived: a network uses at most about 500 pixels on its short side; more than four times that
# only costs time in the other stages.
LARGE_PX = 2500
REDUCED_PX = 1280
"""Longer side that is advised for larger images."""
# Smaller differences are those of the clocks.
_TOLERANCE = 1.1
FLOORLESS = 'points_without_floor'
GRAVITY_SOURCES = 'scale.gravity, use_imu with an IMU, or base_frame'


class Health:
    """
    Collects problems. The worker thread calls `note`, the executor's thread all the rest.

    There is no lock: attributes are replaced as a whole, `_told` only grows between two calls of
    `clear`, and a status may mix two frames.

    Attributes
    ----------
    advice : str
        How frames would take less time, from a measurement; empty: not measured.
    failure : str
        Why the node could not be configured or activated; empty if it could.
    may_pass : bool
        Whether the cause may be temporary, such as an unreachable host.

    """

    def __init__(self, logger: Any):
        self._logger = logger
        self.failure = ''
        self.may_pass = False
        self.clear()

    def clear(self) -> None:
        """Discard the state of earlier frames: missing inputs are logged again."""
        self._gap = ''
        self._told: set[str] = set()
        self._last_told: dict[str, str] = {}
        self._last: Detection | None = None
        self.advice = ''

    @property
    def facts(self) -> dict[str, str]:
        """Facts from the last frame: source of the unit, source of gravity, and advice."""
        facts = _facts_of(self._last) if self._last is not None else {}
        return {**facts, 'advice': self.advice} if self.advice else facts

    def note(self, detection: Detection, wanted: Collection[str]) -> None:
        """Note the result of a frame; ``wanted`` are the outputs that have subscribers."""
        self._last = detection
        if detection.scale_event:
            self._logger.info(detection.scale_event)
        self._gap = gap_of(detection, wanted)
        if self._gap not in self._told and self._gap:
            self._told.add(self._gap)
            self._logger.warning(self._gap)

    def tell_once(self, key: str, warning: str) -> None:
        """Log a warning whose wording may vary, but only once per key."""
        if key not in self._told:
            self._told.add(key)
            self._logger.warning(warning)

    def tell_changes(self, key: str, warning: str) -> None:
        """Log a warning when its wording changes, and again after it was empty."""
        if warning and self._last_told.get(key) != warning:
            self._logger.warning(warning)
        self._last_told[key] = warning

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
        if self._gap:
            return DiagnosticStatus.WARN, self._gap
        return DiagnosticStatus.OK, 'active'


def _facts_of(detection: Detection) -> dict[str, str]:
    """Return what the diagnostics tell of a frame."""
    facts = {'scale': detection.scale_method, 'scale_note': detection.scale_note,
             'gravity': detection.gravity_source}
    if detection.scale_method != RELATIVE:
        facts['noise'] = (f'{detection.disparity_noise:.4f} 1/m, of which '
                          f'{detection.systematic_noise:.4f} bend planes')
    if detection.gravity_note:
        facts['gravity_note'] = detection.gravity_note
    if detection.gravity_probability == detection.gravity_probability:  # not NaN
        facts['gravity_probability'] = f'{detection.gravity_probability:.2f}'
    if detection.camera_height_m == detection.camera_height_m:
        facts['camera_height_m'] = f'{detection.camera_height_m:.3f}'
    if detection.tilt_deg == detection.tilt_deg:
        facts['camera_tilt_deg'] = f'{detection.tilt_deg:.1f}'
    facts['drops'] = (f'none told: {detection.drop_note}' if detection.drop_note
                      else f'{len(detection.drops_m)} points')
    return facts


def gap_of(detection: Detection, wanted: Collection[str]) -> str:
    """
    Return what a frame lacks for classes and obstacles, and the remedy; empty if nothing.

    ``wanted`` are the names of the outputs that have subscribers.
    """
    if not detection.planes:
        return ''
    lost = f', and ~/{FLOORLESS} is silent' if FLOORLESS in wanted else ''
    is_relative = detection.scale_method == RELATIVE
    if any(detection.classes):
        if is_relative and lost:
            return (f'~/{FLOORLESS} is silent: the unit of depth is not known '
                    f'({detection.scale_note})')
        return ''
    if is_relative:
        return (f'planes have no class{lost}: neither metres nor gravity are known; give '
                f'scale.camera_height and {GRAVITY_SOURCES}')
    by_image = f' ({detection.gravity_note})' if detection.gravity_note else ''
    return (f'planes have no class{lost}: the direction of gravity is not known{by_image}; give '
            f'{GRAVITY_SOURCES}')


def slow_network(report: Report, advise: Callable[[float], str]) -> str:
    """
    Return a message if the network takes longer than the period of the camera, else nothing.

    ``advise`` returns advice for a share of the present time, as that of a DepthModel.
    """
    depth_s = report.stage_seconds.get('depth', 0.0)
    if report.arrival_hz == 0 or depth_s * report.arrival_hz <= _TOLERANCE:
        return ''
    advice = advise(1 / (depth_s * report.arrival_hz))
    if not advice:
        return ''
    return (f'the network takes {1e3 * depth_s:.0f} ms, the camera sends an image every '
            f'{1e3 / report.arrival_hz:.0f} ms: {advice}')
