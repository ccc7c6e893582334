# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Frames of a configured node: accepted, processed in stages, published, counted."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from plane_detector.ros.diagnostics import Statistics
from plane_detector.ros.fault_log import FaultLog
from plane_detector.ros.frame_processor import DetectedFrame, FrameProcessor, ObservedFrame
from plane_detector.ros.frame_requests import FrameRequests, describe_frame
from plane_detector.ros.frame_worker import FrameWorker
from plane_detector.ros.health import Health
from plane_detector.ros.inputs.synchronizer import Frame
from plane_detector.ros.live_settings import LiveSettings
from plane_detector.ros.outputs.publishers import OutputPublishers
from plane_detector.ros.point_query import PointQuery
from plane_detector.ros.stamps import stamp_text
from plane_detector.stopping import current_stop


class FrameRecords(NamedTuple):
    """What is told about frames, and to whom; lives as long as the node."""

    statistics: Statistics
    requests: FrameRequests
    faults: FaultLog
    health: Health


class FrameFlow:
    """
    Passes frames through the stages of a processor, each in its own thread.

    Parameters
    ----------
    processor : FrameProcessor
    outputs : OutputPublishers
    query : PointQuery
    live : LiveSettings
        Applied to the processor before each frame.
    records : FrameRecords

    Attributes
    ----------
    worker : FrameWorker
        After `stop` its threads may still run, without the network.

    """

    def __init__(self, processor: FrameProcessor, outputs: OutputPublishers, query: PointQuery,
                 live: LiveSettings, records: FrameRecords) -> None:
        self._processor: FrameProcessor | None = processor
        self._outputs, self._query, self._live = outputs, query, live
        self._records = records
        self.worker = FrameWorker(*(partial(self._or_skip, stage) for stage in (
            # Not bound methods: a worker that was stopped must not keep the network.
            self._observe, lambda frame: self._processor.look(frame),
            lambda frame: self._processor.find_planes(frame), self._publish)))

    def accept(self, frame: Frame) -> None:
        """Pass a frame to the worker if it is wanted; called in the executor's thread."""
        if not self._is_wanted():
            return
        self._records.requests.accept(frame)
        if self.worker.put(frame):
            self._records.statistics.add_dropped(1)

    def drop(self) -> None:
        """Drop the frames being processed, their history, and the clicks that wait for one."""
        self.worker.drop()
        self._query.refuse_all()
        self._processor.reset()

    def stop(self) -> None:
        """Drop all frames, release the network, and return at once."""
        self.worker.stop()
        self._processor = None

    def _is_wanted(self) -> bool:
        """Whether the next frame is requested, or all are and an output has subscribers."""
        if self._records.requests.are_waiting or self._query.is_waiting:
            return True
        return self._live.settings.mode == 'continuous' and bool(self._outputs.wanted())

    def _observe(self, frame: Frame) -> ObservedFrame:
        """Convert and estimate depth; called in the first worker thread."""
        self._live.apply_to(self._processor)
        return self._processor.observe(frame)

    def _publish(self, detected: DetectedFrame) -> None:
        """Make and publish the outputs; called in the last worker thread."""
        processed = self._processor.make(detected, wanted := self._outputs.wanted())
        found, start_s = processed.result.detection, time.perf_counter()
        with current_stop().uncut():
            self._outputs.publish(processed.messages)
            self._query.answer(processed.result)
        statistics, requests, _, health = self._records
        health.note(found, wanted)
        publish_s = time.perf_counter() - start_s
        statistics.add_processed({**processed.stage_seconds, 'publish': publish_s})
        requests.finish(detected.frame, True, describe_frame(processed.result))

    def _or_skip(self, stage: Callable[[Any], Any], given: Any) -> Any:
        """Run a stage of the worker, or log why not: one frame must not end the node."""
        try:
            return stage(given)
        except Exception as error:
            return self._skip(given if isinstance(given, Frame) else given.frame, error)

    def _skip(self, frame: Frame, error: Exception) -> None:
        """Count and log a frame that failed; if it was stopped, its error is ignored."""
        if not current_stop().is_set:
            reason = self._records.faults.tell(error, f'image of {stamp_text(frame.image)}')
            self._records.statistics.add_skipped(reason)
            self._records.requests.finish(frame, False, f'frame skipped: {reason}')
