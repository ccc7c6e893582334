# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""From the frames of a bag to a bag of planes: read, process as the node does, write."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from tqdm import tqdm

from plane_detector.depth.observation import ModelOrFunction
from plane_detector.ros.frame_processor import FrameProcessor, Processed
from plane_detector.ros.inputs.synchronizer import Frame, FrameAssembler, depth_use
from plane_detector.ros.outputs.topics import OUTPUTS
from plane_detector.stopping import Stopped
from plane_detector.tools.replay.bag_reader import BagError, BagReader, to_message
from plane_detector.tools.replay.bag_topics import (
    InputTopics,
    find_camera,
    input_class,
    with_companions,
)
from plane_detector.tools.replay.bag_transforms import read_transforms
from plane_detector.tools.replay.bag_writer import BagWriter
from plane_detector.tools.replay.copies import CopiedMessages
from plane_detector.tools.replay.depth_choice import (
    DepthChoice,
    choose_depth,
    make_detector,
)
from plane_detector.tools.replay.exports import ReplayFiles
from plane_detector.tools.replay.options import ReplayOptions
from plane_detector.tools.replay.part_folder import PartFolder
from plane_detector.tools.replay.resume import Earlier, copy_earlier, read_earlier
from plane_detector.tools.replay.signals import ShouldStop, until_stopped
from plane_detector.tools.replay.tally import (
    DIAGNOSTICS_TOPIC,
    Tally,
    diagnostics_msg,
    scale_of,
)

NODE_NAME = '/plane_detector'


def replay(options: ReplayOptions, should_stop: ShouldStop = lambda: False,
           depth_model: ModelOrFunction | None = None, quiet: bool = False) -> Tally:
    """
    Replay a bag.

    Parameters
    ----------
    options : ReplayOptions
    should_stop : callable
        Checked before and during every frame; written data stays complete.
    depth_model : DepthModel or callable, optional
        Takes the place of the network, as in :class:`PlaneDetector`.
    quiet : bool
        Whether to print neither source nor progress.

    Raises
    ------
    FileNotFoundError, FileExistsError
        There is no bag to read, or there is already one where the new one shall be.
    OSError
        The new bag or the files cannot be written.
    BagError
        The bag cannot be opened, or lacks a topic, with what is there; or no image is in the
        part of it that is asked for.
    ValueError
        The network cannot be run as the settings say.
    Stopped
        It was told to stop before the first frame.

    """
    with ExitStack() as opened:
        bag = opened.enter_context(BagReader(options.source))
        camera = find_camera(bag, options.topics)
        part_ns = _part_asked_for(bag, camera.image, options)
        folder = opened.enter_context(PartFolder(options.target, options.leftover))
        choice = choose_depth(bag, camera, options)
        detector = until_stopped(partial(make_detector, choice.config, depth_model,
                                         threading.get_ident()), should_stop)
        processor = FrameProcessor(detector, options.settings, camera.image,
                                   read_transforms(bag, options.settings))
        wanted = {'depth': choice.topic, **options.topics} if choice.topic else options.topics
        topics = with_companions(bag, camera, wanted, depth_use(choice.config, processor.output),
                                 options.settings.use_imu)
        depth = choice.describe(detector)
        if not quiet:
            print(f'Reading {", ".join(topics.names)} of {options.source}\nDepth: {depth}',
                  file=sys.stderr)
        earlier = read_earlier(folder.before)
        files = opened.enter_context(ReplayFiles(options.figures, options.ply, options.table,
                                                 earlier.next_index,
                                                 bool(choice.config.shapes.wanted)))
        with BagWriter(folder.bag, options.storage, options.compressed) as writer:
            run = _Run(options, bag, part_ns, topics, choice, processor, writer, files)
            tally = run.to_end(earlier, should_stop, depth, quiet)
        _keep(folder, tally)
        return tally


def _keep(folder: PartFolder, tally: Tally) -> None:
    """Give the bag its name, unless it is of no use."""
    if tally.processed or tally.state == 'finished':
        folder.finish()
    else:
        folder.discard()


class _Run:
    """The open parts of a replay, and its loop."""

    def __init__(self, options: ReplayOptions, bag: BagReader, part_ns: tuple[int, int],
                 topics: InputTopics, choice: DepthChoice, processor: FrameProcessor,
                 writer: BagWriter, files: ReplayFiles):
        self._options, self._bag, self._topics = options, bag, topics
        self._start_ns, self._stop_ns = part_ns
        self._processor, self._writer, self._files = processor, writer, files
        self._source = choice.config.depth.source
        self._assembler = FrameAssembler(
            depth_use(choice.config, processor.output), options.settings.stamp_slop,
            choice.config.scale.imu_to_camera)
        self._tally = Tally()
        self._uncommitted: list[int] = []
        self._facts: dict[str, str] = {}

    def to_end(self, earlier: Earlier, should_stop: ShouldStop, depth: str,
               quiet: bool) -> Tally:
        """Process all frames; an error of a bag ends it, one of a frame or a message does not."""
        tally = self._tally
        tally.depth, self._facts = depth, {'depth': depth}
        try:
            self._announce(earlier)
            self._process_all(should_stop, quiet)
        except Stopped:
            tally.interrupted = True
        except (BagError, OSError) as error:
            tally.failure = str(error)
        tally.without_partner = self._assembler.take_dropped()
        tally.damaged += self._bag.damaged
        if not (tally.processed or tally.interrupted or tally.failure):
            tally.failure = f'no frame could be processed. {self._bag.describe()}'
        self._close_books()
        return tally

    def _announce(self, earlier: Earlier) -> None:
        """Announce the topics, and write what an earlier run did."""
        options, writer = self._options, self._writer
        copied = () if options.copied is None else options.copied or self._topics.names
        writer.add_outputs({
            **{_output_topic(name): OUTPUTS[name].msg_type for name in options.outputs},
            DIAGNOSTICS_TOPIC: DiagnosticArray})
        writer.add_copies(self._bag, copied)
        done = copy_earlier(earlier, writer, self._tally)
        self._copies = CopiedMessages(writer, copied, self._topics, options.every, done)

    def _process_all(self, should_stop: ShouldStop, quiet: bool) -> None:
        first = self._tally.resumed_at
        with tqdm(total=self._expected_frames(), unit='frame',
                  disable=True if quiet else None) as progress:
            for index, (time_ns, frame) in enumerate(self._timed_frames()):
                if should_stop():
                    raise Stopped
                if index % self._options.every == 0:
                    self._copies.take(frame)
                    if index >= first:
                        self._take(index, time_ns, frame, should_stop)
                    progress.update()

    def _take(self, index: int, time_ns: int, frame: Frame, should_stop: ShouldStop) -> None:
        """Process a frame and write the results."""
        tally, error = self._tally, ''
        wanted = dict.fromkeys((*self._options.outputs, *self._files.outputs))
        stages: dict[str, float] = {}
        try:
            processed = until_stopped(lambda: self._processor.process(frame, wanted), should_stop)
        except ValueError as raised:
            error = str(raised)
            tally.skipped += 1
            tally.errors[error] += 1
        else:
            stages = dict(processed.stage_seconds)
            self._write(index, time_ns, processed)
        tally.stage_seconds.update(stages)
        start_s = time.perf_counter()
        self._writer.write(DIAGNOSTICS_TOPIC, time_ns, diagnostics_msg(
            frame.image.header, index, tally, self._facts, stages, error))
        if self._writer.end_frame():
            self._uncommitted.clear()
        tally.stage_seconds['write'] += time.perf_counter() - start_s

    def _write(self, index: int, time_ns: int, processed: Processed) -> None:
        """Write files and outputs of a frame, and count it."""
        tally, detection = self._tally, processed.result.detection
        if self._files.is_wanted:
            start_s = time.perf_counter()
            self._files.write(index, processed)
            tally.stage_seconds['files'] += time.perf_counter() - start_s
        start_s = time.perf_counter()
        for name in self._options.outputs:
            if name in processed.messages:  # an output may have nothing to say of a frame
                self._writer.write(_output_topic(name), time_ns, processed.messages[name])
        tally.stage_seconds['write'] += time.perf_counter() - start_s
        tally.processed += 1
        tally.planes += len(detection.planes)
        self._uncommitted.append(len(detection.planes))
        scale = scale_of(self._source, detection)
        tally.scales[scale] += 1
        self._facts.update(scale=scale, gravity=detection.gravity_source,
                           gravity_note=detection.gravity_note)

    def _close_books(self) -> None:
        """Bring all into the file, and how it ended into its metadata."""
        tally = self._tally
        try:
            self._writer.commit()
        except OSError as error:
            tally.failure = tally.failure or str(error)
        if self._writer.is_full:
            tally.processed -= len(self._uncommitted)
            tally.planes -= sum(self._uncommitted)
        self._writer.describe({**tally.to_fields(), 'replay.source': self._bag.path.name,
                               'replay.options': self._options.fingerprint})

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
        for recorded in self._bag.read({*topics.names, *self._copies.topics}, self._start_ns,
                                       self._stop_ns):
            time_ns, msg = recorded.time_ns, None
            if recorded.topic in classes:
                try:
                    msg = to_message(recorded, classes[recorded.topic])
                except BagError:
                    self._tally.damaged += 1
            self._copies.add(recorded, msg)
            if msg is not None:
                yield from ((time_ns, frame) for frame in add[recorded.topic](msg) or ())
        yield from ((time_ns, frame) for frame in assembler.finish())

    def _add_first_calibration(self) -> None:
        """Let images from before the first CameraInfo have it, and those after a late start."""
        topic = self._topics.camera_info
        kind = input_class(self._bag, topic)
        earlier = list(self._bag.messages(topic, kind, None, self._start_ns + 1))
        self._assembler.add_camera_info(earlier[-1] if earlier else self._bag.first(topic, kind))

    def _expected_frames(self) -> int:
        count = {topic.name: topic.count for topic in self._bag.topics}[self._topics.image]
        length_ns = max(self._bag.end_ns - self._bag.start_ns, 1)
        share = np.clip((self._stop_ns - self._start_ns) / length_ns, 0, 1)
        return int(np.ceil(count * share / self._options.every))


def _part_asked_for(bag: BagReader, image: str, options: ReplayOptions) -> tuple[int, int]:
    """Return start and end of the replay; raise if no image lies between them."""
    length_ns = bag.end_ns - bag.start_ns
    start_ns = bag.start_ns + round(min(options.start_s * 1e9, length_ns))
    stop_ns = start_ns + round(min(options.duration_s * 1e9, bag.end_ns - start_ns))
    if start_ns == stop_ns or not any(bag.read([image], start_ns, stop_ns)):
        raise BagError(
            f'{options.source} spans 0 to {length_ns * 1e-9:.3f} s, and in what is '
            f'asked for, --start {options.start_s:g} --duration {options.duration_s:g}, there is '
            f'no image on {image}')
    return start_ns, stop_ns


def _output_topic(name: str) -> str:
    """Return the topic on which the node publishes an output."""
    return f'{NODE_NAME}/{name}'
