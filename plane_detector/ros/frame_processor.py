# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""One frame from messages to messages, in two halves: depth, and planes. No DDS."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from plane_detector.config import NodeConfig
from plane_detector.depth.observation import Observation
from plane_detector.pipeline import PlaneDetector
from plane_detector.ros.inputs.frame_conversion import Picture, PictureConverter
from plane_detector.ros.inputs.synchronizer import Frame
from plane_detector.ros.inputs.transform_buffer import TransformBuffer
from plane_detector.ros.inputs.transforms import CameraPose, FrameTransforms
from plane_detector.ros.outputs import messages
from plane_detector.ros.outputs.topics import OUTPUTS, Result
from plane_detector.tracking.merged_labels import merged_labels
from plane_detector.types import Detection


@dataclass(frozen=True)
class Processed:
    """
    What became of a frame.

    Attributes
    ----------
    messages : mapping of str to message
        By the name of the output: of those that were wanted, those that there are now.
    result : Result
        What they are made of.
    stage_seconds : mapping of str to float
        Time of each stage, conversion and messages included.

    """

    messages: Mapping[str, Any]
    result: Result
    stage_seconds: Mapping[str, float]


@dataclass(frozen=True)
class ObservedFrame:
    """
    A frame with its depth: what the first half of the work hands to the second.

    Attributes
    ----------
    frame : Frame
        The messages.
    picture : Picture
        What they are converted to.
    pose : CameraPose or None
    seen : Observation
    settings : NodeConfig
        Those that this frame is processed with.
    past : tuple of int
        Frames with another one have no common past with this one.
    start_s, converted_s, end_s : float
        By time.perf_counter: when the first half began, had converted, and ended.

    """

    frame: Frame
    picture: Picture
    pose: CameraPose | None
    seen: Observation
    settings: NodeConfig
    past: tuple[int, int]
    start_s: float
    converted_s: float
    end_s: float


class FrameProcessor:
    """
    What the node does with a frame, and the replay too.

    A thread may be in :meth:`finish` with one frame while another is in :meth:`observe` with the
    next; each of the two takes the frames one by one and in order.

    Parameters
    ----------
    detector : PlaneDetector
        The pipeline.
    settings : NodeConfig
        Of the conversion and the outputs.
    image_topic : str
        Where the images come from; a name that ends in rectified says that they are.
    transforms : FrameTransforms, optional
        TF, for the frames that the settings name; default: there are no transforms.

    """

    def __init__(self, detector: PlaneDetector, settings: NodeConfig, image_topic: str,
                 transforms: FrameTransforms | None = None):
        self.detector = detector
        self.settings = settings
        self._converter = PictureConverter(image_topic)
        self._transforms = transforms or FrameTransforms(TransformBuffer())
        self._shown: frozenset[int] = frozenset()
        self._resets = 0
        self._before: Detection | None = None
        self._observed_past = self._finished_past = (0, 0)

    @property
    def output(self) -> str:
        """What the source of depth gives."""
        return self.detector.source.output

    def process(self, frame: Frame, wanted: Collection[str] = tuple(OUTPUTS)) -> Processed:
        """
        Find the planes of a frame and make the messages of the wanted outputs.

        Raises
        ------
        ValueError
            The messages of the frame are not valid, or do not fit together, or a transform is
            missing.

        """
        return self.finish(self.observe(frame), wanted)

    def observe(self, frame: Frame) -> ObservedFrame:
        """Take the first half of :meth:`process`: conversion and depth."""
        start_s, settings, past = time.perf_counter(), self.settings, (frame.epoch, self._resets)
        if past != self._observed_past:
            self.detector.reset_depth()
            self._observed_past = past
        picture = self._converter.convert(frame, settings)
        converted_s = time.perf_counter()
        pose = self._transforms.camera_pose(frame.image.header, settings)
        seen = self.detector.observe(picture.rgb, picture.intrinsics, picture.depth_m,
                                     picture.covered)
        return ObservedFrame(frame, picture, pose, seen, settings, past, start_s, converted_s,
                             time.perf_counter())

    def finish(self, observed: ObservedFrame, wanted: Collection[str] = tuple(OUTPUTS)
               ) -> Processed:
        """Take the second half of :meth:`process`: planes and messages."""
        start_s, seen = time.perf_counter(), observed.seen
        header, settings = observed.frame.image.header, observed.settings
        if observed.past != self._finished_past:
            self.detector.reset_planes()
            self._finished_past, self._before = observed.past, None
        detection = self.detector.find_planes(seen, _down(observed.frame, observed.pose),
                                              _height_m(observed.pose))
        if detection.gravity_source == 'measured':
            by_imu = observed.frame.down_camera is not None
            detection = replace(detection, gravity_source='imu' if by_imu else 'tf')
        detected_s = time.perf_counter()
        result = Result(header, seen.rgb, seen.intrinsics, detection, settings,
                        self._shown, self._transforms.to_target(header, settings),
                        observed.picture.lens,
                        merged_labels(self._before, detection, seen.config.tracking))
        self._before = detection
        made = {name: msg for name in wanted
                if (msg := OUTPUTS[name].make(result)) is not None}
        self._remember_markers(detection, made)
        return Processed(made, result, {
            'convert': observed.converted_s - observed.start_s, **detection.stage_seconds,
            'wait': start_s - observed.end_s, 'messages': time.perf_counter() - detected_s})

    def reset(self) -> None:
        """Forget the past from the next frame on that is observed; any thread may call it."""
        self._resets += 1

    def _remember_markers(self, detection: Detection, made: Mapping[str, Any]) -> None:
        if 'markers' in made:
            self._shown = frozenset([*messages.plane_labels(detection).tolist(),
                                     *messages.shape_labels(detection).tolist()])


def _down(frame: Frame, pose: CameraPose | None) -> np.ndarray | None:
    """Return the direction of gravity: by the IMU, which feels a slope, or else by TF."""
    if frame.down_camera is not None or pose is None:
        return frame.down_camera
    return pose.down_camera


def _height_m(pose: CameraPose | None) -> float | None:
    """Return the height of the camera by TF; a base frame above it says nothing of the floor."""
    return pose.height_m if pose is not None and pose.height_m > 0 else None
