# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Processing of one frame, from messages to messages: depth, planes, outputs. No DDS."""

from __future__ import annotations

import math
import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from plane_detector.config import NodeConfig
from plane_detector.depth.observation import Observation
from plane_detector.directions.finder import Surroundings
from plane_detector.pipeline import PlaneDetector
from plane_detector.ros.inputs.frame_conversion import ConvertedFrame, FrameConverter
from plane_detector.ros.inputs.synchronizer import Frame
from plane_detector.ros.inputs.transform_buffer import TransformBuffer
from plane_detector.ros.inputs.transforms import CameraPose, FrameTransforms
from plane_detector.ros.outputs import messages
from plane_detector.ros.outputs.topics import OUTPUTS, ProcessedFrame
from plane_detector.tracking.merged_labels import merged_labels
from plane_detector.types import Detection


@dataclass(frozen=True)
class FrameOutputs:
    """
    The results of a frame.

    Attributes
    ----------
    messages : mapping of str to message
        By name: the requested outputs that are available for this frame; some are serialised.
    result : ProcessedFrame
        Data that the messages are made from.
    stage_seconds : mapping of str to float
        Time of each stage, including conversion and messages.

    """

    messages: Mapping[str, Any]
    result: ProcessedFrame
    stage_seconds: Mapping[str, float]


@dataclass(frozen=True)
class ObservedFrame:
    """
    A frame with its depth: result of the first stage, input of the second.

    Attributes
    ----------
    frame : Frame
        The messages.
    converted : ConvertedFrame
        The inputs of the pipeline.
    pose : CameraPose or None
    seen : Observation
    settings : NodeConfig
        Settings for this frame.
    past : tuple of int
        Frames share their history only if this is equal.
    stage_seconds : mapping of str to float
        Time of the conversion.
    end_s : float
        By time.perf_counter: end of the stage.

    """

    frame: Frame
    converted: ConvertedFrame
    pose: CameraPose | None
    seen: Observation
    settings: NodeConfig
    past: tuple[int, int]
    stage_seconds: Mapping[str, float]
    end_s: float


@dataclass(frozen=True)
class OrientedFrame:
    """
    A frame with its depth and directions: result of the second stage, input of the third.

    Attributes
    ----------
    observed : ObservedFrame
    around : Surroundings
    stage_seconds : mapping of str to float
        Time of the conversion, and time between the stages so far.
    end_s : float
        By time.perf_counter: end of the stage.

    """

    observed: ObservedFrame
    around: Surroundings
    stage_seconds: Mapping[str, float]
    end_s: float

    @property
    def frame(self) -> Frame:
        """The messages."""
        return self.observed.frame


@dataclass(frozen=True)
class DetectedFrame:
    """
    A frame with its planes: result of the third stage, input of the fourth.

    Attributes
    ----------
    frame : Frame
        The messages.
    result : ProcessedFrame
        Data that the outputs are made from.
    stage_seconds : mapping of str to float
        Time of each stage so far.
    end_s : float
        By time.perf_counter: end of the stage.

    """

    frame: Frame
    result: ProcessedFrame
    stage_seconds: Mapping[str, float]
    end_s: float


class FrameProcessor:
    """
    Processes frames for the node and for replay, in four stages.

    They are :meth:`observe`, :meth:`look`, :meth:`find_planes` and :meth:`make`. While a thread
    runs one of them for a frame, another thread may run the stage before it for the next frame.
    Each of them processes one frame at a time, in order.

    Parameters
    ----------
    detector : PlaneDetector
        The pipeline.
    settings : NodeConfig
        For the conversion and the outputs.
    image_topic : str
        Topic of the images; its name indicates whether they are rectified.
    transforms : FrameTransforms, optional
        TF, for the frames named in the settings; default: no transforms.

    """

    def __init__(self, detector: PlaneDetector, settings: NodeConfig, image_topic: str,
                 transforms: FrameTransforms | None = None):
        self.detector = detector
        self.settings = settings
        self._converter = FrameConverter(image_topic)
        self._transforms = transforms or FrameTransforms(TransformBuffer())
        self._shown: frozenset[int] = frozenset()
        self._resets = 0
        self._before: Detection | None = None
        self._looked_s = -math.inf
        self._observed_past = self._looked_past = self._finished_past = (0, 0)

    @property
    def output(self) -> str:
        """Kind of depth that the source returns."""
        return self.detector.source.output

    def process(self, frame: Frame, wanted: Collection[str] = tuple(OUTPUTS)) -> FrameOutputs:
        """
        Find the planes of a frame and make the messages of the requested outputs.

        Raises
        ------
        ValueError
            The messages are invalid or do not fit together, or a transform is missing.

        """
        return self.make(self.find_planes(self.look(self.observe(frame))), wanted)

    def observe(self, frame: Frame) -> ObservedFrame:
        """Run the first stage of :meth:`process`: conversion and depth."""
        start_s, settings, past = time.perf_counter(), self.settings, (frame.epoch, self._resets)
        if past != self._observed_past:
            self.detector.reset_depth()
            self._observed_past = past
        converted = self._converter.convert(frame, settings)
        converted_s = time.perf_counter()
        pose = self._transforms.camera_pose(frame.image.header, settings)
        seen = self.detector.observe(converted.rgb, converted.intrinsics, converted.depth_m,
                                     converted.covered)
        return ObservedFrame(frame, converted, pose, seen, settings, past,
                             {'convert': converted_s - start_s}, time.perf_counter())

    def look(self, observed: ObservedFrame) -> OrientedFrame:
        """Run the second stage of :meth:`process`: gravity and directions."""
        waited_s = time.perf_counter() - observed.end_s
        if observed.past != self._looked_past:
            self.detector.reset_directions()
            self._looked_past, self._looked_s = observed.past, -math.inf
        down, stamp_s = _down(observed.frame, observed.pose), _stamp_s(observed.frame)
        seen, age_s = observed.seen, stamp_s - self._looked_s
        may_hold = ((seen.is_measured or seen.is_still)
                    and 0 < age_s < seen.config.directions.hold_time)
        around = self.detector.look(seen, down, may_hold)
        if not may_hold:
            self._looked_s = stamp_s
        return OrientedFrame(observed, around, {**observed.stage_seconds, 'wait': waited_s},
                             time.perf_counter())

    def find_planes(self, oriented: OrientedFrame) -> DetectedFrame:
        """Run the third stage of :meth:`process`: planes, shapes and their labels."""
        start_s, observed = time.perf_counter(), oriented.observed
        seen, header, settings = observed.seen, observed.frame.image.header, observed.settings
        if observed.past != self._finished_past:
            self.detector.reset_planes()
            self._finished_past, self._before = observed.past, None
        detection = self.detector.find_planes(seen, oriented.around, _height_m(observed.pose))
        if detection.gravity_source == 'measured':
            by_imu = observed.frame.gravity_camera is not None
            detection = replace(detection, gravity_source='imu' if by_imu else 'tf')
        merging_s = time.perf_counter()
        merged = merged_labels(self._before, detection, seen.config.tracking)
        self._before = detection
        result = ProcessedFrame(header, seen.rgb, seen.intrinsics, detection, settings,
                                to_target=self._transforms.to_target(header, settings),
                                lens=observed.converted.lens, merged=merged)
        end_s, seconds = time.perf_counter(), dict(detection.stage_seconds)
        seconds['tracking'] = seconds.get('tracking', 0.0) + end_s - merging_s
        waited_s = oriented.stage_seconds['wait'] + start_s - oriented.end_s
        return DetectedFrame(observed.frame, result,
                             {**oriented.stage_seconds, **seconds, 'wait': waited_s}, end_s)

    def make(self, detected: DetectedFrame, wanted: Collection[str] = tuple(OUTPUTS)
             ) -> FrameOutputs:
        """Run the last stage of :meth:`process`: the messages of the wanted outputs."""
        start_s, result = time.perf_counter(), replace(detected.result, shown=self._shown)
        made = {name: msg for name in wanted
                if (msg := OUTPUTS[name].make(result)) is not None}
        self._remember_markers(result.detection, made)
        waited_s = detected.stage_seconds['wait'] + start_s - detected.end_s
        return FrameOutputs(made, result, {**detected.stage_seconds, 'wait': waited_s,
                                           'messages': time.perf_counter() - start_s})

    def reset(self) -> None:
        """Discard the history before the next observed frame; thread-safe."""
        self._resets += 1

    def _remember_markers(self, detection: Detection, made: Mapping[str, Any]) -> None:
        if 'markers' in made:
            self._shown = frozenset([*messages.plane_labels(detection).tolist(),
                                     *messages.shape_labels(detection).tolist()])


def _stamp_s(frame: Frame) -> float:
    stamp = frame.image.header.stamp
    return stamp.sec + 1e-9 * stamp.nanosec


def _down(frame: Frame, pose: CameraPose | None) -> np.ndarray | None:
    """Return the direction of gravity from the IMU or else from TF, which cannot see a slope."""
    if frame.gravity_camera is not None or pose is None:
        return frame.gravity_camera
    return pose.gravity_camera


def _height_m(pose: CameraPose | None) -> float | None:
    """Return the height of the camera from TF; None if the camera is below the base frame."""
    return pose.height_m if pose is not None and pose.height_m > 0 else None
