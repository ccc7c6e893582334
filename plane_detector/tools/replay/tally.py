# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Counts of a replay, for people, for the diagnostics in the bag, and for the table."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_msgs.msg import Header

from plane_detector.config import Config
from plane_detector.ros.diagnostics import Report, status_to_msg
from plane_detector.ros.health import gap_of
from plane_detector.types import Detection

DIAGNOSTICS_TOPIC = '/diagnostics'
REPLAY_NAME = 'replay'


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
    processed, without_partner : int
        Frames that gave planes, images without calibration or depth.
    planes : int
        In all frames together.
    damaged : int
        Messages, or sections of the bag, that could not be read and were skipped.
    errors : Counter of str
        Why frames were skipped.
    scales, gaps : Examples
        Where the unit of depth came from; why planes have no class or obstacles are missing.
    depth : str
        The depth or network that was used, and why.
    stage_seconds : Counter of str
        Total time of each stage.
    interrupted : bool
        Whether it was stopped before the end.
    target : Path or None
        The new bag.
    unread : str
        Why the bag could not be read to its end.

    """

    processed: int = 0
    without_partner: int = 0
    planes: int = 0
    damaged: int = 0
    errors: Counter[str] = field(default_factory=Counter)
    scales: Examples = field(default_factory=Examples)
    gaps: Examples = field(default_factory=Examples)
    depth: str = ''
    stage_seconds: Counter[str] = field(default_factory=Counter)
    interrupted: bool = False
    target: Path | None = None
    unread: str = ''

    @property
    def skipped(self) -> int:
        """Number of frames that could not be processed."""
        return self.errors.total()

    @property
    def is_clean(self) -> bool:
        """Whether every message was read and every frame processed."""
        return not (self.skipped or self.damaged or self.unread)

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the time of this block to a stage."""
        start_s = time.perf_counter()
        yield
        self.stage_seconds[stage] += time.perf_counter() - start_s

    def timed_each(self, stage: str, items: Iterator[Any]) -> Iterator[Any]:
        """Yield the items; the time to make them is added to a stage."""
        while True:
            with self.timed(stage):
                item = next(items, None)
            if item is None:
                return
            yield item

    def add(self, detection: Detection, config: Config, outputs: Collection[str]
            ) -> dict[str, str]:
        """Count the result of a frame; return its facts for the diagnostics."""
        self.processed += 1
        self.planes += len(detection.planes)
        scale = _scale_of(config.depth.source, detection)
        self.scales.add(detection.scale_method, scale)
        if gap := gap_of(detection, outputs):
            self.gaps.add(gap.partition(':')[0], gap)
        return {'scale': scale, 'gravity': detection.gravity_source,
                'gravity_note': detection.gravity_note}

    def describe(self) -> str:
        """Return counts, rate and times as readable text."""
        frames = max(self.processed, 1)
        stages = ', '.join(f'{stage} {1e3 * total / frames:.1f}'
                           for stage, total in self.stage_seconds.items())
        seconds = self.stage_seconds.total()
        lines = [f'{self.processed} frames in {seconds:.1f} s: '
                 f'{self.processed / max(seconds, 1e-9):.1f} frames per second',
                 f'ms per frame: {stages}']
        lines += [f'Scale of {line}' for line in self.scales.lines()]
        return '\n'.join([*lines, *self.gaps.lines(), *self.losses()])

    def losses(self) -> list[str]:
        """Return a line for each kind of loss: frames and messages that were not used."""
        lines = [f'{count} frames skipped: {error}' for error, count in self.errors.items()]
        if self.without_partner:
            lines.append(f'{self.without_partner} images had no calibration or depth')
        if self.damaged:
            lines.append(f'{self.damaged} damaged messages were skipped')
        return lines + ([self.unread] if self.unread else [])

    def to_fields(self) -> dict[str, str]:
        """Return the fields for the metadata of the bag."""
        return {'replay.state': 'interrupted' if self.interrupted else 'finished',
                'replay.frames': str(self.processed), 'replay.planes': str(self.planes),
                'replay.skipped': str(self.skipped), 'replay.damaged': str(self.damaged),
                'replay.seconds': f'{self.stage_seconds.total():.3f}',
                'replay.depth': self.depth}


def _scale_of(depth_source: str, detection: Detection) -> str:
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
    facts = {'frame': str(index), 'planes_in_all': str(tally.planes), **facts}
    return DiagnosticArray(header=header, status=[
        status_to_msg(REPLAY_NAME, level, message, report, facts)])
