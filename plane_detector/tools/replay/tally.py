# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Counts of a replay, for people, for the diagnostics in the bag, and for the table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_msgs.msg import Header

from plane_detector.ros.diagnostics import Report, status_to_msg
from plane_detector.types import Detection

DIAGNOSTICS_TOPIC = '/diagnostics'
REPLAY_NAME = 'replay'
FRAME_KEY = 'frame'


@dataclass
class Examples:
    """
    Counts by kind, with the first text of each: the texts may differ from frame to frame.

    Examples
    --------
    >>> floors = Examples()
    >>> floors.add('floor', 'floor 1.2 m below')
    >>> floors.add('floor', 'floor 1.3 m below')
    >>> floors.lines()
    ['2 frames: floor 1.2 m below (in the first of them)']

    """

    counts: Counter[str] = field(default_factory=Counter)
    texts: dict[str, str] = field(default_factory=dict)
    varying: set[str] = field(default_factory=set)

    def add(self, kind: str, text: str) -> None:
        """Count a frame."""
        self.counts[kind] += 1
        if self.texts.setdefault(kind, text) != text:
            self.varying.add(kind)

    def lines(self) -> list[str]:
        """Return a line for each kind."""
        return [f'{count} frames: {self.texts[kind]}'
                + (' (in the first of them)' if kind in self.varying else '')
                for kind, count in self.counts.items()]


@dataclass
class Tally:
    """
    Counts and results so far.

    Attributes
    ----------
    processed, skipped, without_partner : int
        Frames that gave planes, that could not be processed, images without calibration or
        depth.
    planes : int
        In all frames together.
    damaged : int
        Messages, or sections of the bag, that could not be read and were skipped.
    resumed_at : int
        Number of the first frame that an earlier run had not processed.
    errors : Counter of str
        Why frames were skipped.
    scales, gaps : Examples
        Where the unit of depth came from; why planes have no class or obstacles are missing.
    depth : str
        The depth or network that was used, and why.
    stage_seconds : Counter of str
        Total time of each stage.
    interrupted : bool
    failure : str
        Why the bag could not be read or written to its end.

    """

    processed: int = 0
    skipped: int = 0
    without_partner: int = 0
    planes: int = 0
    damaged: int = 0
    resumed_at: int = 0
    errors: Counter[str] = field(default_factory=Counter)
    scales: Examples = field(default_factory=Examples)
    gaps: Examples = field(default_factory=Examples)
    depth: str = ''
    stage_seconds: Counter[str] = field(default_factory=Counter)
    interrupted: bool = False
    failure: str = ''

    @property
    def seconds(self) -> float:
        """All stages together."""
        return sum(self.stage_seconds.values())

    @property
    def state(self) -> str:
        """Final state in one or two words."""
        if self.interrupted:
            return 'interrupted'
        return 'broken off' if self.failure else 'finished'

    def describe(self) -> str:
        """Return counts, rate and times as readable text."""
        frames = max(self.processed, 1)
        stages = ', '.join(f'{stage} {1e3 * total / frames:.1f}'
                           for stage, total in self.stage_seconds.items())
        lines = [f'{self.processed} frames in {self.seconds:.1f} s: '
                 f'{self.processed / max(self.seconds, 1e-9):.1f} frames per second',
                 f'ms per frame: {stages}']
        lines += [f'Scale of {line}' for line in self.scales.lines()]
        lines += self.gaps.lines()
        if self.without_partner:
            lines.append(f'{self.without_partner} images had no calibration or depth')
        if self.damaged:
            lines.append(f'{self.damaged} damaged messages were skipped')
        lines += [f'{count} frames skipped: {error}' for error, count in self.errors.items()]
        if self.interrupted:
            lines.insert(0, 'interrupted: the results so far are complete, --resume continues')
        return '\n'.join(lines)

    def to_fields(self) -> dict[str, str]:
        """Return the fields for the metadata of the bag."""
        return {'replay.state': self.state, 'replay.frames': str(self.processed),
                'replay.planes': str(self.planes), 'replay.skipped': str(self.skipped),
                'replay.damaged': str(self.damaged), 'replay.seconds': f'{self.seconds:.3f}',
                'replay.depth': self.depth, 'replay.error': self.failure}


def scale_of(depth_source: str, detection: Detection) -> str:
    """Return the source of the unit of depth, with the note of the method."""
    if depth_source == 'topic':
        return 'metres, as measured'
    method, note = detection.scale_method, detection.scale_note
    if not note or note.startswith(method):
        return note or method
    return f'{method}, {note}'


def diagnostics_msg(header: Header, index: int, tally: Tally, facts: Mapping[str, str],
                    stage_seconds: Mapping[str, float], error: str = '') -> DiagnosticArray:
    """
    Return the diagnostics of one frame, as the node publishes them once a second.

    Parameters
    ----------
    header : std_msgs.msg.Header
        Of the image.
    index : int
        Number of the frame in the bag.
    tally : Tally
        With this frame.
    facts : mapping of str to str
        Further keys and values.
    stage_seconds : mapping of str to float
        Empty for a frame that was skipped.
    error : str
        Why it was.

    """
    total_s = sum(stage_seconds.values())
    report = Report(tally.processed, tally.without_partner, tally.skipped,
                    1 / total_s if total_s else 0.0, stage_seconds,
                    skipped_lately=bool(error), last_error=error)
    level, message = ((DiagnosticStatus.WARN, f'frame skipped: {error}') if error
                      else (DiagnosticStatus.OK, 'replayed'))
    facts = {FRAME_KEY: str(index), 'planes_in_all': str(tally.planes), **facts}
    return DiagnosticArray(header=header, status=[
        status_to_msg(REPLAY_NAME, level, message, report, facts)])
