# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""From the frames of a bag to a bag of planes: read, process as the node does, write."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from tqdm import tqdm

from plane_detector.config import Config, NodeConfig
from plane_detector.pipeline import PlaneDetector
from plane_detector.ros.frame_processor import FrameProcessor, Processed
from plane_detector.ros.inputs.synchronizer import Frame, FrameAssembler, depth_use
from plane_detector.ros.outputs.topics import OUTPUTS
from plane_detector.tools.replay.bag_reader import BagError, BagReader, to_message
from plane_detector.tools.replay.bag_topics import (
    InputTopics,
    find_camera,
    input_class,
    with_companions,
)
from plane_detector.tools.replay.bag_writer import BagWriter
from plane_detector.tools.replay.exports import ReplayFiles

NODE_NAME = '/plane_detector'


@dataclass(frozen=True)
class ReplayOptions:
    """
    What is replayed, and what is made of it.

    Attributes
    ----------
    source, target : Path
        The bag that is read, and the new one.
    config : Config
    settings : NodeConfig
    topics : mapping of str to str
        Input topics asked for; see :func:`find_camera`.
    start_s, duration_s : float
        The part of the bag that is replayed, from its first message on.
    every : int
        Of so many frames the first is taken.
    outputs : tuple of str
        Names of the outputs that are written.
    copied : tuple of str or None
        Topics that are copied; an empty tuple: the inputs; None: nothing.
    storage : str
        ``mcap`` or ``sqlite3``.
    compressed : bool
    figures, ply, table : Path or None
        See :class:`ReplayFiles`.

    """

    source: Path
    target: Path
    config: Config = field(default_factory=Config)
    settings: NodeConfig = field(default_factory=NodeConfig)
    topics: Mapping[str, str] = field(default_factory=dict)
    start_s: float = 0.0
    duration_s: float = float('inf')
    every: int = 1
    outputs: tuple[str, ...] = tuple(OUTPUTS)
    copied: tuple[str, ...] | None = None
    storage: str = 'mcap'
    compressed: bool = False
    figures: Path | None = None
    ply: Path | None = None
    table: Path | None = None


@dataclass
class Tally:
    """
    What was done so far.

    Attributes
    ----------
    processed, skipped, without_partner : int
        Frames that gave planes, that could not be processed, pictures without calibration or
        depth.
    errors : Counter of str
        Why frames were skipped.
    stage_seconds : Counter of str
        Total time of each stage.
    interrupted : bool
    failure : str
        Why the bag could not be read to its end.

    """

    processed: int = 0
    skipped: int = 0
    without_partner: int = 0
    errors: Counter[str] = field(default_factory=Counter)
    stage_seconds: Counter[str] = field(default_factory=Counter)
    interrupted: bool = False
    failure: str = ''

    def describe(self) -> str:
        """Return counts, rate and times for people."""
        seconds = sum(self.stage_seconds.values())
        frames = max(self.processed, 1)
        stages = ', '.join(f'{stage} {1e3 * total / frames:.1f}'
                           for stage, total in self.stage_seconds.items())
        lines = [f'{self.processed} frames in {seconds:.1f} s: '
                 f'{self.processed / max(seconds, 1e-9):.1f} frames per second',
                 f'ms per frame: {stages}']
        if self.without_partner:
            lines.append(f'{self.without_partner} pictures had no calibration or depth')
        lines += [f'{count} frames skipped: {error}' for error, count in self.errors.items()]
        if self.interrupted:
            lines.insert(0, 'interrupted: the results so far are complete')
        return '\n'.join(lines)


def replay(options: ReplayOptions, should_stop: Callable[[], bool] = lambda: False,
           estimate_depth: Callable[[np.ndarray], np.ndarray] | None = None) -> Tally:
    """
    Replay a bag.

    Parameters
    ----------
    options : ReplayOptions
    should_stop : callable
        Asked before every frame; what is written stays whole.
    estimate_depth : callable, optional
        Takes the place of the network, as in :class:`PlaneDetector`.

    Raises
    ------
    FileNotFoundError, FileExistsError
        There is no bag to read, or there is already one where the new one shall be.
    BagError
        The bag cannot be opened, or lacks a topic, with what is there; or no picture is in the
        part of it that is asked for.
    ValueError
        The network cannot be run as the settings say.

    """
    with ExitStack() as opened:
        bag = opened.enter_context(BagReader(options.source))
        camera = find_camera(bag, options.topics)
        part_ns = _part_asked_for(bag, camera.image, options)
        if options.target.exists():
            raise FileExistsError(f'{options.target} is there already: choose another name')
        detector = PlaneDetector(options.config, estimate_depth)
        processor = FrameProcessor(detector, options.settings, camera.image)
        use = depth_use(options.config, processor.output)
        topics = with_companions(bag, camera, options.topics, use, options.settings.use_imu)
        print(f'Reading {", ".join(topics.names)} of {options.source}', file=sys.stderr)
        writer = opened.enter_context(
            BagWriter(options.target, options.storage, options.compressed))
        writer.add_outputs({_output_topic(name): OUTPUTS[name].msg_type
                            for name in options.outputs})
        files = opened.enter_context(ReplayFiles(options.figures, options.ply, options.table))
        assembler = FrameAssembler(use, options.settings.stamp_slop,
                                   options.config.scale.imu_to_camera)
        run = _Run(options, bag, part_ns, topics, assembler, processor, writer, files)
        return run.to_end(should_stop)


class _Run:
    """The open parts of a replay, and its loop."""

    def __init__(self, options: ReplayOptions, bag: BagReader, part_ns: tuple[int, int],
                 topics: InputTopics, assembler: FrameAssembler, processor: FrameProcessor,
                 writer: BagWriter, files: ReplayFiles):
        self._options, self._bag, self._topics = options, bag, topics
        self._start_ns, self._stop_ns = part_ns
        self._assembler, self._processor = assembler, processor
        self._writer, self._files = writer, files
        copied = options.copied
        self._copied = () if copied is None else copied or topics.names
        writer.add_copies(bag, self._copied)
        self._tally = Tally()

    def to_end(self, should_stop: Callable[[], bool]) -> Tally:
        """Process all frames; an error of the bag ends it, one of a frame does not."""
        tally = self._tally
        with tqdm(total=self._expected_frames(), unit='frame', disable=None) as progress:
            try:
                for index, (time_ns, frame) in enumerate(self._timed_frames()):
                    if should_stop():
                        tally.interrupted = True
                        break
                    if index % self._options.every == 0:
                        self._take(index, time_ns, frame)
                        progress.update()
            except BagError as error:
                tally.failure = str(error)
        tally.without_partner = self._assembler.take_dropped()
        if not (tally.processed or tally.interrupted or tally.failure):
            tally.failure = f'no frame could be processed. {self._bag.describe()}'
        return tally

    def _take(self, index: int, time_ns: int, frame: Frame) -> None:
        """Process a frame and write what comes of it."""
        options, tally = self._options, self._tally
        wanted = dict.fromkeys((*options.outputs, *self._files.outputs))
        try:
            processed = self._processor.process(frame, wanted)
        except ValueError as error:
            tally.skipped += 1
            tally.errors[str(error)] += 1
            return
        start_s = time.perf_counter()
        self._write(time_ns, processed)
        tally.stage_seconds.update(processed.stage_seconds)
        tally.stage_seconds['write'] += time.perf_counter() - start_s
        if self._files.is_wanted:
            start_s = time.perf_counter()
            self._files.write(index, processed)
            tally.stage_seconds['files'] += time.perf_counter() - start_s
        tally.processed += 1

    def _write(self, time_ns: int, processed: Processed) -> None:
        for name in self._options.outputs:
            if name in processed.messages:  # an output may have nothing to say of a frame
                self._writer.write(_output_topic(name), time_ns, processed.messages[name])

    def _timed_frames(self) -> Iterator[tuple[int, Frame]]:
        """Yield the frames, the time that reading them takes on the tally."""
        frames = self._frames()
        while True:
            start_s = time.perf_counter()
            entry = next(frames, None)
            self._tally.stage_seconds['read'] += time.perf_counter() - start_s
            if entry is None:
                return
            yield entry

    def _frames(self) -> Iterator[tuple[int, Frame]]:
        """Yield frames, with the time at which their last message was recorded."""
        topics, assembler, time_ns = self._topics, self._assembler, self._start_ns
        add = {topics.image: assembler.add_image, topics.camera_info: assembler.add_camera_info,
               topics.depth: assembler.add_depth, topics.imu: assembler.add_imu}
        classes = {name: input_class(self._bag, name) for name in topics.names}
        self._add_first_calibration()
        for recorded in self._bag.read({*topics.names, *self._copied}, self._start_ns,
                                       self._stop_ns):
            time_ns = recorded.time_ns
            if recorded.topic in self._copied:
                self._writer.copy(recorded)
            if recorded.topic in classes:
                msg = to_message(recorded, classes[recorded.topic])
                yield from ((time_ns, frame) for frame in add[recorded.topic](msg) or ())
        yield from ((time_ns, frame) for frame in assembler.finish())

    def _add_first_calibration(self) -> None:
        """Let pictures from before the first CameraInfo have it, and those after a late start."""
        topic = self._topics.camera_info
        earlier = list(self._bag.read([topic], None, self._start_ns + 1))
        first = earlier[-1:] or [next(self._bag.read([topic]))]
        self._assembler.add_camera_info(to_message(first[0], input_class(self._bag, topic)))

    def _expected_frames(self) -> int:
        count = {topic.name: topic.count for topic in self._bag.topics}[self._topics.image]
        length_ns = max(self._bag.end_ns - self._bag.start_ns, 1)
        share = np.clip((self._stop_ns - self._start_ns) / length_ns, 0, 1)
        return int(np.ceil(count * share / self._options.every))


def _part_asked_for(bag: BagReader, image: str, options: ReplayOptions) -> tuple[int, int]:
    """Return from when on and until when is replayed; an error where no picture is in between."""
    length_ns = bag.end_ns - bag.start_ns
    start_ns = bag.start_ns + round(min(options.start_s * 1e9, length_ns))
    stop_ns = start_ns + round(min(options.duration_s * 1e9, bag.end_ns - start_ns))
    if start_ns == stop_ns or not any(bag.read([image], start_ns, stop_ns)):
        raise BagError(
            f'{options.source} spans 0 to {length_ns * 1e-9:.3f} s, and in what is '
            f'asked for, --start {options.start_s:g} --duration {options.duration_s:g}, there is '
            f'no picture on {image}')
    return start_ns, stop_ns


def _output_topic(name: str) -> str:
    """Return the topic on which the node publishes an output."""
    return f'{NODE_NAME}/{name}'
