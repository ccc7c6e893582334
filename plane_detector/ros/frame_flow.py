# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Frames of a configured node: accepted, processed, published, counted."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from functools import partial
from typing import NamedTuple

from plane_detector.ros.diagnostics import Statistics
from plane_detector.ros.fault_log import FaultLog
from plane_detector.ros.frame_processor import FrameOutputs, FrameProcessor
from plane_detector.ros.frame_requests import FrameRequests, describe_frame
from plane_detector.ros.frame_worker import FrameWorker
from plane_detector.ros.health import LARGE_PX, REDUCED_PX, Health
from plane_detector.ros.inputs.synchronizer import Frame
from plane_detector.ros.live_settings import LiveSettings
from plane_detector.ros.outputs.frame import DetectedFrame
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
    Passes frames to a processor in a worker thread, and its results to those who wait for them.

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
        After `stop` its thread may still run.

    """

    def __init__(self, processor: FrameProcessor, outputs: OutputPublishers, query: PointQuery,
                 live: LiveSettings, records: FrameRecords) -> None:
        self._processor: FrameProcessor | None = processor
        self._outputs, self._query, self._live = outputs, query, live
        self._records = records
        self.worker = FrameWorker(self._begin, overlaps=processor.has_network)

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

    def _reduced_time(self, frame: Frame, wanted: Collection[str], whole: FrameOutputs) -> str:
        """Return how long a large frame took, and how long it takes when it is reduced first."""
        (height, width), whole_s = (whole.result.detection.labels.shape,
                                    sum(whole.stage_seconds.values()))
        reduced_s = self._processor.seconds_with(REDUCED_PX, frame, wanted)
        return (f'an image of {width} x {height} takes {1e3 * whole_s:.0f} ms, with max_side '
                f'{REDUCED_PX} {1e3 * reduced_s:.0f} ms')

    def _is_wanted(self) -> bool:
        """Whether the next frame is requested, or all are and an output has subscribers."""
        if self._records.requests.are_waiting or self._query.is_waiting:
            return True
        return self._live.settings.mode == 'continuous' and bool(self._outputs.wanted())

    def _begin(self, frame: Frame) -> Callable[[], None]:
        """Do the first half of the work on a frame; return a function that does the second."""
        try:
            self._live.apply_to(self._processor)
            seen = self._processor.see(frame)
            if self._processor.has_network:  # which takes as long as all the rest
                return partial(self._finish, frame, partial(self._processor.find, seen))
            found = self._processor.find(seen)
        except Exception as error:
            return partial(self._skip, frame, error)
        return partial(self._finish, frame, lambda: found)

    def _finish(self, frame: Frame, find: Callable[[], DetectedFrame]) -> None:
        """Publish the planes of a frame, or log why not."""
        statistics, requests, _, health = self._records
        try:
            found, wanted = find(), self._outputs.wanted()
            processed = self._processor.make(found, wanted)
            with current_stop().uncut():  # all of this or, after a stop, nothing of it
                start_s = time.perf_counter()
                self._outputs.publish(processed.messages)
                self._query.answer(processed.result)
                publish_s = time.perf_counter() - start_s
                health.note(processed.result.detection, wanted)
                statistics.add_processed({**processed.stage_seconds, 'publish': publish_s},
                                         processed.result)
                requests.finish(frame, True, describe_frame(processed.result))
            if max(processed.result.detection.labels.shape) > LARGE_PX and not health.advice:
                health.advice = self._reduced_time(frame, wanted, processed)
        except Exception as error:
            self._skip(frame, error)

    def _skip(self, frame: Frame, error: Exception) -> None:
        """Log why a frame has no result: one frame must not end the node."""
        with current_stop().uncut():
            reason = self._records.faults.tell(error, f'image of {stamp_text(frame.image)}')
            self._records.statistics.add_skipped(reason)
            self._records.requests.finish(frame, False, f'frame skipped: {reason}')
