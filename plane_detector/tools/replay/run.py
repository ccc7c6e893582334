# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""From the frames of a bag to a bag of planes: read, process like the node, write."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from functools import partial

from diagnostic_msgs.msg import DiagnosticArray
from tqdm import tqdm

from plane_detector.depth.observation import ModelOrFunction
from plane_detector.ros.frame_processor import FrameOutputs, FrameProcessor
from plane_detector.ros.health import gap_of
from plane_detector.ros.inputs.synchronizer import Frame, FrameSynchronizer, depth_use
from plane_detector.ros.kernels import load_kernels
from plane_detector.ros.outputs.topics import OUTPUTS
from plane_detector.stopping import Stopped
from plane_detector.tools.replay.bag_reader import BagError, BagReader
from plane_detector.tools.replay.bag_topics import (
    InputTopics,
    find_camera,
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
from plane_detector.tools.replay.frame_reader import FrameReader, part_asked_for
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
        Used instead of the network, as in :class:`PlaneDetector`.
    quiet : bool
        Whether to print neither the source of depth nor the progress.

    Raises
    ------
    OSError, BagError, ValueError, Stopped
        A bag cannot be opened or written, a topic is missing, the network cannot run, or a stop
        was requested.

    """
    with BagReader(options.source) as bag:
        camera = find_camera(bag, options.topics)
        part_ns = part_asked_for(bag, camera.image, options)
        with PartFolder(options.target, options.leftover) as folder:
            choice = choose_depth(bag, camera, options)
            detector = until_stopped(partial(make_detector, choice.config, depth_model,
                                             threading.get_ident()), should_stop)
            processor = FrameProcessor(detector, options.settings, camera.image,
                                       read_transforms(bag, options.settings))
            reader = _open_frames(bag, camera, part_ns, choice, processor, options)
            depth = choice.describe(detector)
            tell = _tell_nobody if quiet else partial(print, file=sys.stderr)
            tell(f'Reading {", ".join(reader.topics.names)} of {options.source}\n'
                 f'Depth: {depth}')
            until_stopped(partial(load_kernels, choice.config, tell), should_stop)
            tally = _Run(options, reader, processor, depth).to_end(folder, should_stop, quiet)
            _keep(folder, tally)
            return tally


def _open_frames(bag: BagReader, camera: InputTopics, part_ns: tuple[int, int],
                 choice: DepthChoice, processor: FrameProcessor, options: ReplayOptions
                 ) -> FrameReader:
    """Return the frames that the settings require."""
    use = depth_use(choice.config, processor.output)
    wanted = {'depth': choice.topic, **options.topics} if choice.topic else options.topics
    topics = with_companions(bag, camera, wanted, use, options.settings.use_imu)
    return FrameReader(bag, topics, part_ns, FrameSynchronizer(
        use, options.settings.stamp_slop, choice.config.scale.imu_to_camera))


def _tell_nobody(_text: str) -> None:
    """Workers of many bags do not print."""


def _keep(folder: PartFolder, tally: Tally) -> None:
    """Rename the bag to its final path, unless it is of no use."""
    if tally.processed or tally.state == 'finished':
        folder.finish()
    else:
        folder.discard()


class _Run:
    """Open files and state of a replay, and its loop."""

    def __init__(self, options: ReplayOptions, reader: FrameReader, processor: FrameProcessor,
                 depth: str):
        self._options, self._reader, self._processor = options, reader, processor
        self._config = processor.detector.config
        self._tally = Tally(depth=depth)
        self._uncommitted: list[int] = []
        self._facts = {'depth': depth}

    def to_end(self, folder: PartFolder, should_stop: ShouldStop, quiet: bool) -> Tally:
        """Process all frames; an error of a bag ends the replay, one of a frame does not."""
        options, earlier = self._options, read_earlier(folder.before)
        with (ReplayFiles(options.figures, options.ply, options.table, earlier.next_index,
                          bool(self._config.shapes.wanted)) as self._files,
              BagWriter(folder.bag, options.storage, options.compressed) as self._writer):
            self._process(earlier, should_stop, quiet)
        return self._tally

    def _process(self, earlier: Earlier, should_stop: ShouldStop, quiet: bool) -> None:
        tally, reader = self._tally, self._reader
        try:
            self._announce(earlier)
            self._process_all(should_stop, quiet)
        except Stopped:
            tally.interrupted = True
        except (BagError, OSError) as error:
            tally.failure = str(error)
        tally.without_partner = reader.take_dropped()
        tally.damaged += reader.damaged + reader.bag.damaged
        if not (tally.processed or tally.interrupted or tally.failure):
            tally.failure = f'no frame could be processed. {reader.bag.describe()}'
        self._close_books()

    def _announce(self, earlier: Earlier) -> None:
        """Announce the topics, and write the messages of an earlier run."""
        options, writer = self._options, self._writer
        copied = () if options.copied is None else options.copied or self._reader.topics.names
        writer.add_outputs({
            **{_output_topic(name): OUTPUTS[name].msg_type for name in options.outputs},
            DIAGNOSTICS_TOPIC: DiagnosticArray})
        writer.add_copies(self._reader.bag, copied)
        done = copy_earlier(earlier, writer, self._tally)
        self._copies = CopiedMessages(writer, copied, self._reader.topics, options.every, done)

    def _process_all(self, should_stop: ShouldStop, quiet: bool) -> None:
        first = self._tally.resumed_at
        with tqdm(total=self._reader.expected_frames(self._options.every), unit='frame',
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

    def _write(self, index: int, time_ns: int, processed: FrameOutputs) -> None:
        """Write files and outputs of a frame, and count it."""
        tally, detection = self._tally, processed.result.detection
        if self._files.is_wanted:
            start_s = time.perf_counter()
            self._files.write(index, processed)
            tally.stage_seconds['files'] += time.perf_counter() - start_s
        start_s = time.perf_counter()
        for name in self._options.outputs:
            if name in processed.messages:  # some outputs are not available for every frame
                self._writer.write(_output_topic(name), time_ns, processed.messages[name])
        tally.stage_seconds['write'] += time.perf_counter() - start_s
        tally.processed += 1
        tally.planes += len(detection.planes)
        self._uncommitted.append(len(detection.planes))
        scale = scale_of(self._config.depth.source, detection)
        tally.scales.add(detection.scale_method, scale)
        if gap := gap_of(detection, self._options.outputs):
            tally.gaps.add(gap.partition(':')[0], gap)
        self._facts.update(scale=scale, gravity=detection.gravity_source,
                           gravity_note=detection.gravity_note)

    def _close_books(self) -> None:
        """Commit everything, and write the final state into the metadata."""
        tally = self._tally
        try:
            self._writer.commit()
        except OSError as error:
            tally.failure = tally.failure or str(error)
        if self._writer.is_full:
            tally.processed -= len(self._uncommitted)
            tally.planes -= sum(self._uncommitted)
        self._writer.describe({**tally.to_fields(), 'replay.source': self._reader.bag.path.name,
                               'replay.options': self._options.fingerprint})

    def _timed_frames(self) -> Iterator[tuple[int, Frame]]:
        """Yield the frames; the time to read them is added to the tally."""
        frames = self._reader.frames(self._copies)
        while True:
            start_s = time.perf_counter()
            entry = next(frames, None)
            self._tally.stage_seconds['read'] += time.perf_counter() - start_s
            if entry is None:
                return
            yield entry


def _output_topic(name: str) -> str:
    """Return the topic on which the node publishes an output."""
    return f'{NODE_NAME}/{name}'
