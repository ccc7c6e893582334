# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""From the frames of a bag to a bag of planes: read, process like the node, write."""

from __future__ import annotations

import os
import sys
import threading
from functools import lru_cache

from diagnostic_msgs.msg import DiagnosticArray
from tqdm import tqdm

from plane_detector.config import DepthConfig
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.depth.observation import ModelOrFunction
from plane_detector.pipeline import PlaneDetector
from plane_detector.ros.frame_processor import FrameProcessor
from plane_detector.ros.inputs.synchronizer import FrameSynchronizer, depth_use
from plane_detector.ros.kernels import load_kernels
from plane_detector.ros.outputs.topics import OUTPUTS
from plane_detector.stopping import Stopped, raise_if_stopped
from plane_detector.tools.replay.bag_reader import BagError, BagReader
from plane_detector.tools.replay.bag_writer import BagWriter, Draft
from plane_detector.tools.replay.exports import ReplayFiles
from plane_detector.tools.replay.frame_reader import (
    CopiedMessages,
    FrameReader,
    read_transforms,
    requested_times,
)
from plane_detector.tools.replay.input_topics import choose_depth, find_camera, with_companions
from plane_detector.tools.replay.options import NODE_NAME, ReplayOptions
from plane_detector.tools.replay.tally import DIAGNOSTICS_TOPIC, Tally, diagnostics_msg

INTERRUPTED = 'interrupted_'
"""Prefix of the names of what an interrupted replay has made so far."""


def replay(options: ReplayOptions, depth_model: ModelOrFunction | None = None,
           quiet: bool = False) -> Tally:
    """
    Replay a bag.

    The new bag gets its name when it is whole. If the work is stopped
    (:mod:`plane_detector.stopping`), the bag of the frames so far gets the prefix `INTERRUPTED`.

    Parameters
    ----------
    options : ReplayOptions
    depth_model : DepthModel or callable, optional
        Used instead of the network, as in :class:`PlaneDetector`.
    quiet : bool
        Whether to print neither the source of depth nor the progress.

    Raises
    ------
    OSError, BagError, ValueError, Stopped
        A bag cannot be opened or written, a topic is missing, no frame can be processed, the
        network cannot run, or a stop was requested before the first frame.

    """
    def tell(text: str) -> None:
        if not quiet:
            print(text, file=sys.stderr)

    with BagReader(options.source) as bag, Draft(options.target) as draft:
        if os.path.lexists(options.target):
            raise FileExistsError(f'{options.target} already exists: choose another name')
        camera = find_camera(bag, options.topics)
        times_ns = requested_times(bag, camera.image, options)
        choice = choose_depth(bag, camera, options)
        config = choice.config
        if depth_model is None and config.depth.source == 'model':
            depth_model = _network(config.depth, threading.get_ident())
        processor = FrameProcessor(PlaneDetector(config, depth_model), options.settings,
                                   camera.image, read_transforms(bag, options.settings))
        topics = with_companions(bag, camera, choice, processor.output, options)
        reader = FrameReader(bag, topics, times_ns, FrameSynchronizer(
            depth_use(config, processor.output), options.settings.stamp_slop,
            config.scale.imu_to_camera))
        tally = Tally(choice.describe(processor.detector.source.facts))
        remedy = '; --network uses a network instead' if choice.topic else ''
        tell(f'Reading {", ".join(topics.names)} of {options.source}')
        tell(f'Depth: {tally.depth}{remedy}')
        load_kernels(config, tell)
        with ReplayFiles(options.figures, options.ply, options.table,
                         bool(config.shapes.wanted)) as files:
            with BagWriter(draft.path, options.storage, options.compressed) as writer:
                _process(reader, processor, writer, files, options, tally, quiet)
                writer.describe({**tally.to_fields(), 'replay.source': options.source.name,
                                 'replay.options': options.fingerprint})
            prefix = INTERRUPTED if tally.interrupted else ''
            files.publish(prefix)
            tally.target = draft.publish(prefix)
        return tally


def _process(reader: FrameReader, processor: FrameProcessor, writer: BagWriter,
             files: ReplayFiles, options: ReplayOptions, tally: Tally, quiet: bool) -> None:
    """Process the frames, to the end of the bag or of what can be read, or to a stop."""
    copied = () if options.copied is None else options.copied or reader.topics.names
    writer.add_outputs({**{_topic(name): OUTPUTS[name].msg_type for name in options.outputs},
                        DIAGNOSTICS_TOPIC: DiagnosticArray})
    writer.add_copies(reader.bag, copied)
    copies = CopiedMessages(writer, copied, reader.topics, options.every)
    wanted = dict.fromkeys((*options.outputs, *files.outputs))
    facts = {'depth': tally.depth}
    progress = tqdm(total=reader.expected_frames(options.every), unit='frame',
                    disable=True if quiet else None)
    frames = tally.timed_each('read', reader.frames(copies))
    try:
        for index, (time_ns, frame) in enumerate(frames):
            raise_if_stopped()
            if index % options.every:
                continue
            copies.take(frame)
            processed, error = None, ''
            try:
                processed = processor.process(frame, wanted)
            except ValueError as raised:
                error = str(raised)
                tally.errors[error] += 1
            else:
                tally.stage_seconds.update(processed.stage_seconds)
                facts |= tally.add(processed.result.detection, processor.detector.config,
                                   options.outputs)
                with tally.timed('files'):
                    files.write(index, processed)
            with tally.timed('write'):
                for name in options.outputs if processed else ():
                    if name in processed.messages:  # some are not available for every frame
                        writer.write(_topic(name), time_ns, processed.messages[name])
                writer.write(DIAGNOSTICS_TOPIC, time_ns, diagnostics_msg(
                    frame.image.header, index, tally, facts, processed, error))
            progress.update()
    except Stopped:
        tally.interrupted = True
    except BagError as error:
        tally.unread = str(error)
    finally:
        progress.close()
    tally.without_partner = reader.take_dropped()
    tally.damaged += reader.damaged + reader.bag.damaged
    if not tally.processed:
        if tally.interrupted:
            raise Stopped
        raise BagError(tally.unread or '\n'.join(
            ['no frame could be processed', *tally.losses(), reader.bag.describe()]))


@lru_cache(maxsize=8)
def _network(config: DepthConfig, _thread: int) -> DepthEstimator:
    """Return a network, cached per thread: a worker loads it once for all its bags."""
    return DepthEstimator(config)


def _topic(name: str) -> str:
    """Return the topic on which the node publishes an output."""
    return f'/{NODE_NAME}/{name}'
