# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Frames of a configured node: accepted, processed in threads, published, counted.

A call of ~/detect is answered when a frame that arrived after it is processed.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial
from queue import Queue
from typing import Any, Generic, NamedTuple, TypeVar

from rclpy.task import Future

from plane_detector._runtime.stopping import (
    Background,
    Stop,
    Stopped,
    current_stop,
    raise_if_stopped,
)
from plane_detector.ros.diagnostics import Health, Statistics
from plane_detector.ros.fault_log import FaultLog
from plane_detector.ros.frame_processor import FrameProcessor, make_messages, placement_problem
from plane_detector.ros.inputs.synchronizer import Frame, stamp_text
from plane_detector.ros.live_settings import LiveSettings
from plane_detector.ros.outputs.frame import DetectedFrame
from plane_detector.ros.outputs.pictures import Pictures
from plane_detector.ros.outputs.topics import OUTPUTS, OutputPublishers
from plane_detector.ros.point_query import PointQuery

Result, Item = TypeVar('Result'), TypeVar('Item')
ANSWERED_WITHIN_S = 30.0
"""A call that gets no frame is answered after this time."""
MOST_CALLS = 16
"""No more calls than this may wait, because each takes time of the executor."""


class FrameWorker(Generic[Item]):
    """
    Processes frames in order; one more may wait, and a newer one replaces it.

    ``begin`` is called with each frame, and returns the function that finishes it, which is called
    after that of the frame before. Both run under a stop for the frame, and must not raise, except
    Stopped. If it ``overlaps``, frames are finished in a second thread, while the next one is
    begun. This is only worthwhile if beginning takes long, because two Python threads wait for
    each other.
    """

    def __init__(self, begin: Callable[[Item], Callable[[], None]], overlaps: bool):
        self._begin, self._overlaps = begin, overlaps
        self._changed = threading.Condition()
        self._waiting: Item | None = None
        self._stops: tuple[Stop, ...] = ()
        self._ended = False
        self._begun: Queue[Callable[[], object] | None] = Queue()
        self._thread = Background(self._run, 'frame_worker')

    def put(self, frame: Item) -> bool:
        """Set the next frame; return whether it replaced one that was waiting."""
        with self._changed:
            replaced, self._waiting = self._waiting is not None, frame
            self._changed.notify()
        return replaced

    def drop(self) -> None:
        """
        Drop the waiting frame, stop those being processed, and return at once.

        The next frame starts when the work on the last one has ended, at the latest at its next
        check for a stop.
        """
        with self._changed:
            self._waiting, stops = None, self._stops
        for stop in stops:
            stop.set()

    def stop(self) -> None:
        """Drop all frames, accept no more, and return at once."""
        with self._changed:
            self._ended = True
            self._changed.notify()
        self.drop()

    def wait(self, timeout_s: float) -> bool:
        """Wait, after `stop`, for the work to end; return False after a timeout."""
        return self._thread.wait(timeout_s)

    def _run(self) -> None:
        finisher = Background(self._finish, 'frame_finisher')
        while (frame := self._take()) is not None:
            stop = self._stops[-1]
            finish = _under(stop, partial(self._begin, frame))
            del frame  # no reference while waiting
            self._begun.join()  # the previous frame is finished
            if finish is not None and self._overlaps:
                self._begun.put(partial(_under, stop, finish))
            elif finish is not None:
                _under(stop, finish)
            del finish
        self._begun.put(None)
        finisher.wait()

    def _finish(self) -> None:
        """Finish frames, in the second thread."""
        while (finish := self._begun.get()) is not None:
            finish()
            del finish
            self._begun.task_done()

    def _take(self) -> Item | None:
        """Wait for the next frame; None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._ended or self._waiting is not None)
            frame, self._waiting = self._waiting, None
            self._stops = (*self._stops[-1:], Stop())  # of the previous frame too
            return None if self._ended else frame


def _under(stop: Stop, work: Callable[[], Result]) -> Result | None:
    """Return the result of some work; None if nobody is waiting for it any more."""
    try:
        with stop.applies():
            raise_if_stopped()
            return work()
    except Stopped:
        return None


class _Call(NamedTuple):
    after: int  # number of frames accepted before it
    until_s: float
    future: Future


class FrameRequests:
    """
    Waiting calls; thread-safe for the executor and the worker.

    ``wake`` wakes the executor, so that it sends answers given by another thread.
    """

    def __init__(self, wake: Callable[[], None]):
        self._wake = wake
        self._lock = threading.Lock()
        self._calls: list[_Call] = []
        self._count = 0

    @property
    def are_waiting(self) -> bool:
        """Whether there is a call for which no frame has been accepted yet."""
        with self._lock:
            return bool(self._calls) and self._calls[-1].after == self._count

    def add(self) -> Future:
        """Request the next frame; the future's result is (True, its result) or (False, why)."""
        future = Future()
        with self._lock:
            if len(self._calls) < MOST_CALLS:
                until_s = time.monotonic() + ANSWERED_WITHIN_S
                self._calls.append(_Call(self._count, until_s, future))
                return future
        future.set_result((False, f'{MOST_CALLS} calls are already waiting for a frame'))
        return future

    def accept(self) -> int:
        """Return the number of a frame for the worker; it or a later one answers all calls."""
        with self._lock:
            self._count += 1
            return self._count

    def finish(self, number: int, success: bool, answer: Any) -> None:
        """Answer the calls for which this frame, by its number, or an earlier one was accepted."""
        self._answer(lambda call: call.after < number, success, answer)

    def expire(self, obstacle: str) -> None:
        """Answer calls that have waited too long, or all if the reason for no frame is known."""
        now_s = time.monotonic()
        if obstacle:
            self.refuse_all(f'no frame: {obstacle}')
        self._answer(lambda call: call.until_s <= now_s, False,
                     f'no frame within {ANSWERED_WITHIN_S:.0f} s')

    def refuse_all(self, reason: str) -> None:
        """Answer all calls: no frame will be processed."""
        self._answer(lambda _: True, False, reason)

    def _answer(self, is_due: Callable[[_Call], bool], success: bool, answer: Any) -> None:
        if not self._calls:
            return
        with self._lock:
            due = [call for call in self._calls if is_due(call)]
            self._calls = [call for call in self._calls if not is_due(call)]
        for call in due:
            call.future.set_result((success, answer))
        if due:
            self._wake()


def describe_frame(result: DetectedFrame) -> str:
    """Return the answer to a call: number of planes and stamp of the image."""
    return f'{len(result.detection.planes)} planes in the image of {stamp_text(result)}'


class FrameRecords(NamedTuple):
    """Where results of frames are reported; lives as long as the node."""

    statistics: Statistics
    requests: FrameRequests
    faults: FaultLog
    health: Health


class FrameFlow:
    """
    Passes frames to a processor in a worker thread, and its results to whoever waits for them.

    The live settings are applied to the processor before each frame. After `stop` the thread of
    ``worker`` may still run.
    """

    def __init__(self, processor: FrameProcessor, outputs: OutputPublishers, query: PointQuery,
                 live: LiveSettings, records: FrameRecords):
        self._processor: FrameProcessor | None = processor
        self._outputs, self._query, self._live = outputs, query, live
        self._records = records
        self.pictures = Pictures(self._publish_pictures)
        self.worker = FrameWorker(self._begin, overlaps=processor.has_network)

    def accept(self, frame: Frame) -> None:
        """
        Pass a frame to the worker if it is requested, or all are and an output has subscribers.

        Called in the thread of the executor.
        """
        requests = self._records.requests
        is_requested = requests.are_waiting or self._query.is_waiting
        if not is_requested and (self._live.settings.mode != 'continuous' or (
                self._processor.map is None and not self._outputs.wanted())):
            return
        if self.worker.put((requests.accept(), frame)):
            self._records.statistics.add_dropped(1)

    def drop(self) -> None:
        """Drop the frames being processed, their history, and the clicks that wait for one."""
        self.worker.drop()
        self.pictures.drop()
        self._query.refuse_all()
        self._processor.detector.reset()

    def stop(self) -> None:
        """Drop all frames, release the network, and return at once."""
        self.worker.stop()
        self.pictures.drop()
        self._processor = None

    def _begin(self, numbered: tuple[int, Frame]) -> Callable[[], None]:
        """Do the first half of the work on a frame; return a function that does the second."""
        number, frame = numbered
        try:
            processor, live = self._processor, self._live
            processor.settings = live.settings
            processor.detector.config = live.late_kernels.without_unready_shapes(live.config)
            return partial(self._finish, number, frame, processor.begin(frame))
        except Exception as error:
            return partial(self._skip, number, frame, error)

    def _finish(self, number: int, frame: Frame, find: Callable[[], DetectedFrame]) -> None:
        """Publish the planes of a frame, or log why not."""
        statistics, requests, _, health = self._records
        try:
            found, wanted = find(), self._outputs.wanted()
            messages = make_messages(found, self.pictures.due(found, wanted))
            with current_stop().uncut():  # all of this or, after a stop, none of it
                start_s = time.perf_counter()
                self._outputs.publish(messages)
                if problem := placement_problem(found, wanted):
                    raise ValueError(problem)
                self._query.answer(found)
                publish_s = time.perf_counter() - start_s
                health.note(found.detection, wanted, found.stamp_s)
                statistics.add_processed({**found.timer.seconds, 'publish': publish_s}, found)
                requests.finish(number, True, found)
        except Exception as error:
            self._skip(number, frame, error)

    def _publish_pictures(self, found: DetectedFrame) -> None:
        """Publish the pictures of an image, in the thread of the executor."""
        wanted = [name for name in self._outputs.wanted() if OUTPUTS[name].is_picture]
        try:
            self._outputs.publish(make_messages(found, wanted))
        except Exception as error:  # as of any other frame
            self._records.faults.report(error, f'pictures of {stamp_text(found)}')

    def _skip(self, number: int, frame: Frame, error: Exception) -> None:
        """Log why a frame has no result: one frame must not end the node."""
        with current_stop().uncut():
            reason = self._records.faults.report(error, f'image of {stamp_text(frame.image)}')
            self._records.statistics.add_skipped(reason)
            self._records.requests.finish(number, False, f'frame skipped: {reason}')
