# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""From the frames of a bag to a bag of planes: read, process like the node, write, count."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_msgs.msg import Header
from tqdm import tqdm

from plane_detector._runtime.plain_text import plain
from plane_detector._runtime.stopping import Stopped
from plane_detector.config import Config, DepthConfig
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.pipeline import PlaneDetector
from plane_detector.ros.diagnostics import (
    Report,
    missing_for_classes,
    planes_status,
    status_to_msg,
)
from plane_detector.ros.fault_log import reason_of
from plane_detector.ros.frame_processor import FrameProcessor, placement_problem
from plane_detector.ros.inputs.synchronizer import FrameSynchronizer, depth_use
from plane_detector.ros.live_map import LiveMap
from plane_detector.ros.live_settings import load_kernels
from plane_detector.ros.outputs.frame import DetectedFrame
from plane_detector.ros.outputs.topics import MAP_OUTPUTS, OUTPUTS, make_map_messages
from plane_detector.tools.replay.bag_reader import BagError, BagReader
from plane_detector.tools.replay.inputs import (
    CopiedMessages,
    ReadFrame,
    choose_inputs,
    imu_to_camera,
    read_frames,
    read_transforms,
    requested_times,
    transform_topics,
)
from plane_detector.tools.replay.options import NODE_NAME, ReplayOptions
from plane_detector.tools.replay.writer import AtomicOutput, BagWriter, ReplayFiles
from plane_detector.types import Detection

INTERRUPTED = 'interrupted_'  # prefix of the name of an interrupted bag
_DIAGNOSTICS_TOPIC = '/diagnostics'
_REPLAY_NAME = 'replay'
_MOST_SHOWN = 10_000  # characters, of the names of all topics


@dataclass
class Tally:
    """Counts and results of a replay so far."""

    depth: str  # the depth or network that was used, and why
    processed: int = 0  # frames that gave planes
    planes: int = 0  # total over all frames
    errors: Counter[str] = field(default_factory=Counter)  # why frames were skipped
    without_partner: int = 0  # images without calibration or depth
    unpaired: int = 0  # of these, those between the first and the last frame
    damaged: int = 0  # messages, or sections of the bag, that could not be read
    unread: str = ''  # why the bag could not be read to the end
    interrupted: bool = False  # stopped before the end
    target: Path | None = None  # the new bag
    seconds: float = 0.0  # of all frames
    stage_seconds: Counter[str] = field(default_factory=Counter)  # the rest is reading
    map_events: list[str] = field(default_factory=list)  # jumps of the poses
    map_problem: str = ''  # of the poses or the map at the end
    # Source of the unit of depth, and why planes have no class, of each frame by kind.
    scales: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    gaps: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))

    @property
    def skipped(self) -> int:
        """Number of frames that could not be processed."""
        return self.errors.total()

    @property
    def is_clean(self) -> bool:
        """Whether every message was read and every frame between the first and last processed."""
        return not (self.skipped or self.damaged or self.unpaired or self.unread)

    def add(self, detection: Detection, config: Config, outputs: Collection[str]
            ) -> dict[str, str]:
        """Count the result of a frame; return its facts for the diagnostics."""
        self.processed += 1
        self.planes += len(detection.planes)
        scale = _scale_of(config.depth.source, detection)
        self.scales[detection.scale.unit_method].append(scale)
        if gap := missing_for_classes(detection, outputs):
            self.gaps[gap.partition(':')[0]].append(gap)
        return {'scale': scale, 'gravity': detection.gravity.source,
                'gravity_note': detection.gravity.note}

    def add_dropped(self, count: int) -> None:
        """Count images without a partner before a frame."""
        self.without_partner += count
        self.unpaired += count if self.processed or self.skipped else 0

    def add_error(self, error: Exception) -> str:
        """Count a frame that was skipped; return the reason."""
        reason = reason_of(error)
        self.errors[reason] += 1
        return reason

    def describe(self) -> str:
        """Return counts, rate and times as readable text."""
        frames = max(self.processed, 1)
        read = {'read': self.seconds - self.stage_seconds.total()}
        stages = ', '.join(f'{stage} {1e3 * total / frames:.1f}'
                           for stage, total in (read | self.stage_seconds).items())
        lines = [f'{self.processed} frames in {self.seconds:.1f} s: '
                 f'{self.processed / max(self.seconds, 1e-9):.1f} frames per second',
                 f'ms per frame: {stages}']
        lines += [f'Scale of {line}' for line in _counted(self.scales)]
        lines += [*_counted(self.gaps), *self.map_events, *filter(None, [self.map_problem])]
        return '\n'.join([*lines, *self.losses()])

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
                'replay.unpaired': str(self.unpaired), 'replay.seconds': f'{self.seconds:.3f}',
                'replay.depth': self.depth}


def _counted(texts: Mapping[str, list[str]]) -> list[str]:
    """Return a line for each kind, with the first of its texts, which may vary by frame."""
    return [f'{len(of_kind)} frames: {of_kind[0]}'
            + (' (in the first of them)' if len(set(of_kind)) > 1 else '')
            for of_kind in texts.values()]


def _scale_of(depth_source: str, detection: Detection) -> str:
    """Return the source of the unit of depth, with the note of the method."""
    if depth_source != 'model':
        return 'metres, as measured'
    method = detection.scale.unit_method
    note = '; '.join(filter(None, (str(detection.scale), detection.input_note)))
    return note if note.startswith(method) else f'{method}, {note}'


def diagnostics_msg(header: Header, index: int, tally: Tally, facts: Mapping[str, str],
                    found: DetectedFrame | None, error: str = '') -> DiagnosticArray:
    """Return the diagnostics of a frame, with the tally so far; an error: it was skipped."""
    stage_seconds = found.timer.seconds if found else {}
    total_s = sum(stage_seconds.values())
    report = Report(tally.processed, tally.without_partner, tally.skipped,
                    1 / total_s if total_s else 0.0, stage_seconds,
                    skipped_lately=bool(error), last_error=error)
    level, message = ((DiagnosticStatus.WARN, f'frame skipped: {error}') if error
                      else (DiagnosticStatus.OK, 'replayed'))
    statuses = [status_to_msg(_REPLAY_NAME, level, message, report,
                              {'frame': str(index), **facts})]
    if found is not None:
        statuses.append(planes_status(_REPLAY_NAME, found, tally.planes))
    return DiagnosticArray(header=header, status=statuses)


def replay(options: ReplayOptions, quiet: bool = False) -> Tally:
    """
    Replay a bag.

    The new bag gets its name when it is complete. If the work is stopped
    (`plane_detector._runtime.stopping`), the bag of the frames so far gets the prefix
    `INTERRUPTED`. With ``quiet``, neither the source of depth nor the progress is printed.

    Raises
    ------
    OSError, BagError, ValueError, Stopped
        A bag cannot be opened or written, a topic is missing, no frame can be processed, the
        network cannot run, or a stop was requested before the first frame.

    """
    def report(text: str) -> None:
        if not quiet:
            print(plain(text, _MOST_SHOWN), file=sys.stderr)

    with BagReader(options.source) as bag, AtomicOutput(options.target) as draft:
        if os.path.lexists(options.target):
            raise FileExistsError(f'{options.target} already exists: choose another name')
        inputs = choose_inputs(bag, options)
        config, topics = inputs.config, inputs.topics
        times_ns = requested_times(bag, topics.image, options)
        network = (None if config.depth.is_measured
                   else _network(config.depth, threading.get_ident()))
        transforms = read_transforms(bag, options.settings, topics)
        live_map = _map_of(config, options)
        processor = FrameProcessor(PlaneDetector(config, network), options.settings,
                                   topics.image, transforms, live_map)
        use = depth_use(config, processor.detector.source.output)
        if use == 'unused':
            topics = replace(topics, depth='')
        synchronizer = FrameSynchronizer(use, options.settings.stamp_slop,
                                         imu_to_camera(bag, inputs, transforms))
        tally = Tally(inputs.describe(processor.detector.source.facts))
        is_chosen = options.depth_by_bag and config.depth.is_measured
        remedy = '; --network uses a network instead' if is_chosen else ''
        report(f'Reading {", ".join(topics.names)} of {options.source}')
        report(f'Depth: {tally.depth}{remedy}')
        load_kernels(config, report)
        with ReplayFiles(options.figures, options.ply, options.table,
                         bool(config.shapes.wanted), options.map_file) as files:
            with BagWriter(draft.path, options.storage, options.compressed) as writer:
                writer.add_outputs({_topic(name): OUTPUTS[name].msg_type
                                    for name in options.outputs}
                                   | {_DIAGNOSTICS_TOPIC: DiagnosticArray})
                if live_map:
                    writer.add_outputs({_topic(name): output.msg_type
                                        for name, output in MAP_OUTPUTS.items()}, are_latched=True)
                copied = () if options.copied is None else options.copied or (
                    *topics.names, *(transform_topics(bag) if transforms else ()))
                writer.add_copies(bag, copied)
                frames = read_frames(bag, topics, times_ns, synchronizer,
                                     CopiedMessages(writer, copied, topics, options.every))
                total = _expected_frames(bag, topics.image, times_ns) // options.every
                _process(tqdm(frames, total=total, unit='frame', disable=True if quiet else None),
                         processor, writer, files, options, tally)
                tally.without_partner += synchronizer.take_dropped()
                tally.damaged = bag.damaged
                if tally.interrupted and not tally.processed:
                    raise Stopped
                if not tally.processed:
                    raise BagError(tally.unread or '\n'.join(
                        ['no frame could be processed', *tally.losses(), bag.describe()]))
                writer.describe({**tally.to_fields(), 'replay.source': options.source.name,
                                 'replay.options': options.fingerprint})
            prefix = INTERRUPTED if tally.interrupted else ''
            if options.map_file is not None:
                report(live_map.save(options.map_file.with_name(prefix + options.map_file.name)))
            files.publish(prefix)
            tally.target = draft.publish(prefix)
        return tally


def _process(frames: Iterable[ReadFrame], processor: FrameProcessor, writer: BagWriter,
             files: ReplayFiles, options: ReplayOptions, tally: Tally) -> None:
    """Process the frames, to the end of the bag or of what can be read, or to a stop."""
    config, facts, live_map = processor.detector.config, {'depth': tally.depth}, processor.map
    wanted = dict.fromkeys((*options.outputs, *files.outputs))
    begun_s = time.perf_counter()
    try:
        for index, time_ns, frame, dropped in frames:
            tally.add_dropped(dropped)
            found, error = None, ''
            try:
                found, messages = processor.process(frame, wanted)
            except Exception as raised:  # as in the node, one bad frame does not end the replay
                error = tally.add_error(raised)
            else:
                tally.stage_seconds.update(found.timer.seconds)
                if problem := placement_problem(found, wanted):
                    error = tally.add_error(ValueError(problem))
                else:
                    facts |= tally.add(found.detection, config, options.outputs)
                if live_map:
                    facts |= {**live_map.facts(), 'map_problem': live_map.problem()}
                    tally.map_events.extend(live_map.take_events())
            done_s = time.perf_counter()
            if found is not None:
                files.write(index, found, messages)
                for name in messages:
                    if name in options.outputs or name in MAP_OUTPUTS:
                        writer.write(_topic(name), time_ns, messages[name])
            writer.write(_DIAGNOSTICS_TOPIC, time_ns, diagnostics_msg(
                frame.image.header, index, tally, facts, found, error))
            tally.stage_seconds['write'] += time.perf_counter() - done_s
    except Stopped:
        tally.interrupted = True
    except BagError as error:
        tally.unread = str(error)
    if live_map:  # the map after the last image, whenever it was published last
        for name, msg in make_map_messages(live_map.take_view()).items():
            writer.write(_topic(name), time_ns, msg)
        tally.map_problem = live_map.problem()
    tally.seconds = time.perf_counter() - begun_s


def _expected_frames(bag: BagReader, image: str, times_ns: tuple[int, int]) -> int:
    """Return the approximate number of images between two times."""
    count = next(topic.count for topic in bag.topics if topic.name == image)
    return round(count * (times_ns[1] - times_ns[0]) / (bag.end_ns - bag.start_ns))


def _map_of(config: Config, options: ReplayOptions) -> LiveMap | None:
    """Return the map, from a file if one is to be loaded; None if no map is wanted."""
    if not config.map.enabled:
        return None
    live_map = LiveMap(config.map, options.settings.target_frame)
    if options.load_map is not None:
        live_map.load(options.load_map)
    return live_map


@lru_cache(maxsize=8)
def _network(config: DepthConfig, _thread: int) -> DepthEstimator:
    """Return a network, cached per thread: a worker loads it once for all its bags."""
    return DepthEstimator(config)


def _topic(name: str) -> str:
    """Return the topic on which the node publishes an output."""
    return f'/{NODE_NAME}/{name}'
