# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Processing of one frame, from messages to messages: depth, planes, outputs. No DDS."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from std_msgs.msg import Header

from plane_detector.config import NodeConfig
from plane_detector.depth.observation import DepthFunction, ModelDepth, Observation
from plane_detector.depth.plausibility import CORRIDOR_LENS, corridor
from plane_detector.geometry.disparity import to_depth, to_disparity
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.pipeline import PlaneDetector
from plane_detector.ros.calibration import camera_info_to_msg
from plane_detector.ros.inputs.frame_conversion import ConvertedFrame, FrameConverter
from plane_detector.ros.inputs.synchronizer import Frame, ns_of
from plane_detector.ros.inputs.transforms import CameraPose, FrameTransforms, TransformBuffer
from plane_detector.ros.outputs.frame import DetectedFrame
from plane_detector.ros.outputs.messages import rgb_to_msg
from plane_detector.ros.outputs.topics import OUTPUTS
from plane_detector.stage_timer import StageTimer, median_seconds
from plane_detector.tracking.tracker import merged_labels
from plane_detector.types import Detection

# Noise and blur of a network's depth, for timing the stages after it.
_NOISE_PER_M, _BLUR_PX = 0.005, 12.0
# While a camera does not turn, as its planes tell, the lines are held for so many times longer,
# and each time that they are found again for twice as long, up to 2 s.
_STEADY_TIMES, _MOST_STEADY_TIMES = 5, 20
# derived: a tenth of what gravity from an image may be off. With noise of .001, .002 and .004 per
# metre on real images, 100, 92 and 82 % of the frames of a still camera are within it.
_TURNED_RAD = math.radians(0.5)
# Of a plane whose normal counts, and between two of them: a plane does not tell turns about it.
_LARGE_SHARE, _APART_RAD = 0.02, math.radians(20)


@dataclass(frozen=True)
class SeenFrame:
    """A frame with its depth, and what belongs to it: the result of `FrameProcessor.see`."""

    frame: Frame
    converted: ConvertedFrame
    observation: Observation
    settings: NodeConfig
    transforms: Callable[[], tuple[CameraPose | None, RigidTransform | None]]
    starts_anew: bool
    stage_seconds: Mapping[str, float]


@dataclass(frozen=True)
class FrameOutputs:
    """What goes out for a frame: messages by output, what they show, times of the stages."""

    messages: Mapping[str, Any]
    result: DetectedFrame
    stage_seconds: Mapping[str, float]


class FrameProcessor:
    """
    Processes frames for the node and for replay, one at a time, in order.

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
        self._image_topic, self._converter = image_topic, FrameConverter(image_topic)
        self._transforms = transforms or FrameTransforms(TransformBuffer())
        self._before: Detection | None = None
        self._lines_s = -math.inf
        self._normals: dict[int, np.ndarray] = {}  # by label, when the lines were found
        self._hold_times = 1
        self._epoch = 0
        self._is_reset = False

    @property
    def output(self) -> str:
        """Kind of depth that the source returns."""
        return self.detector.source.output

    @property
    def has_network(self) -> bool:
        """Whether the depth is from a network, which takes long."""
        return isinstance(self.detector.source, ModelDepth)

    def process(self, frame: Frame, wanted: Collection[str] = tuple(OUTPUTS)) -> FrameOutputs:
        """
        Find the planes of a frame and make the messages of the requested outputs.

        Raises
        ------
        ValueError
            The messages are invalid or do not fit together, or a transform is missing.

        """
        return self.make(self.find(self.see(frame)), wanted)

    def see(self, frame: Frame) -> SeenFrame:
        """
        Find the depth of a frame.

        This, `find` and `make` are the parts of :meth:`process`: each takes the frames in order,
        and other threads may do the later parts for the frames before.
        """
        settings, stages, starts_anew = self.settings, StageTimer(), self._starts_anew(frame)
        if starts_anew:
            self.detector.reset_depth()
        with stages('convert'):
            # 1. The messages as arrays.
            converted = self._converter.convert(frame, settings)
            transforms = self._transforms.awaited(frame.image.header, settings)
        # 2. Depth; meanwhile TF may receive the transforms of this image.
        seen = self.detector.observe(converted.rgb, converted.intrinsics, converted.depth_m,
                                     converted.covered)
        return SeenFrame(frame, converted, seen, settings, transforms, starts_anew,
                         stages.seconds)

    def find(self, begun: SeenFrame) -> DetectedFrame:
        """Find the planes of a frame."""
        frame, seen, stages = begun.frame, begun.observation, StageTimer()
        stages.seconds |= begun.stage_seconds
        if begun.starts_anew:
            self._lines_s, self._hold_times, self._before = -math.inf, 1, None
            self.detector.reset_directions()
            self.detector.reset_planes()
        with stages('wait'):
            pose, to_target = begun.transforms()
        # 3. Gravity and lines, those found shortly before if nothing moves; then planes.
        stamp_s = 1e-9 * ns_of(frame.image)
        hold_s = seen.config.directions.hold_time * self._hold_times
        may_hold = (seen.is_measured or seen.is_still) and 0 < stamp_s - self._lines_s < hold_s
        around = self.detector.look(seen, _down(frame, pose), may_hold)
        detection = self.detector.find_planes(seen, around, _height_m(pose))
        normals = _normals_of(detection)
        if not may_hold:
            longer = 1 if _has_turned(self._normals, normals) else 2 * self._hold_times
            self._hold_times = min(max(longer, _STEADY_TIMES), _MOST_STEADY_TIMES)
            self._lines_s, self._normals = stamp_s, normals
        if (not seen.is_measured or detection.gravity_camera is None
                or _has_turned(self._normals, normals)):
            self._hold_times = 1
        if detection.gravity_source == 'measured':
            by_imu = frame.gravity_camera is not None
            detection = replace(detection, gravity_source='imu' if by_imu else 'tf')
        with stages('tracking'):
            merged = merged_labels(self._before, detection)
            self._before = detection
        return DetectedFrame(frame.image.header, seen.rgb, seen.intrinsics, detection,
                              begun.settings, to_target, begun.converted.distortion, merged,
                              _sum(detection.stage_seconds, stages.seconds))

    @staticmethod
    def make(result: DetectedFrame, wanted: Collection[str]) -> FrameOutputs:
        """Make the messages of some outputs, as far as they are available."""
        stages = StageTimer()
        with stages('messages'):
            made = {name: msg for name in wanted
                    if (msg := OUTPUTS[name].make(result)) is not None}
        return FrameOutputs(made, result, {**result.stage_seconds, **stages.seconds})

    def seconds_with(self, max_side: int, frame: Frame, wanted: Collection[str]) -> float:
        """Return the time that a frame would take if its image were reduced to this side first."""
        model = self.detector.source.model if self.has_network else None
        other = FrameProcessor(PlaneDetector(self.detector.config, model),
                               replace(self.settings, max_side=max_side), self._image_topic,
                               self._transforms)
        return median_seconds(lambda: other.process(frame, wanted))

    def reset(self) -> None:
        """Discard the history before the next frame; thread-safe."""
        self._is_reset = True

    def _starts_anew(self, frame: Frame) -> bool:
        """Return whether time jumped back before this frame, or a reset was asked for."""
        starts_anew = frame.epoch != self._epoch or self._is_reset
        self._epoch, self._is_reset = frame.epoch, False
        return starts_anew


def _normals_of(detection: Detection) -> dict[int, np.ndarray]:
    """Return the normals of the large planes by their labels."""
    large = detection.planes.counts >= _LARGE_SHARE * detection.labels.size
    planes = detection.planes.picked(large)
    return dict(zip(planes.labels.tolist(), planes.normals, strict=True))


def _has_turned(before: dict[int, np.ndarray], after: dict[int, np.ndarray]) -> bool:
    """Return False if two planes have the same normals as before: then no turn is possible."""
    same = np.array([normal for label, normal in before.items() if label in after
                     and np.linalg.norm(after[label] - normal) < _TURNED_RAD])
    return not same.size or bool((abs(same @ same.T) > math.cos(_APART_RAD)).all())


def _sum(first: Mapping[str, float], second: Mapping[str, float]) -> dict[str, float]:
    return {name: first.get(name, 0.0) + second.get(name, 0.0) for name in {**first, **second}}


def _down(frame: Frame, pose: CameraPose | None) -> np.ndarray | None:
    """Return the direction of gravity from the IMU or else from TF, which cannot see a slope."""
    if frame.gravity_camera is not None or pose is None:
        return frame.gravity_camera
    return pose.gravity_camera


def _height_m(pose: CameraPose | None) -> float | None:
    """Return the height of the camera from TF; None if the camera is below the base frame."""
    return pose.height_m if pose is not None and pose.height_m > 0 else None


def fit_to_rate(detector: PlaneDetector) -> None:
    """Choose the largest network input that keeps ``depth.target_rate``, if both are given."""
    rate_hz = detector.config.depth.target_rate
    if rate_hz > 0 and detector.config.depth.source == 'model':
        detector.source.fit_to_rate(rate_hz, _seconds_beside_the_network(detector))


def _seconds_beside_the_network(detector: PlaneDetector) -> float:
    """Return the time of all other work on a frame with depth like that of a network."""
    rgb, depth_m = corridor()
    rng = np.random.default_rng(0)
    smooth = cv2.GaussianBlur(rng.standard_normal(depth_m.shape), (0, 0), _BLUR_PX)
    noise = _NOISE_PER_M * (smooth / smooth.std() + rng.standard_normal(depth_m.shape))
    noisy_m = to_depth(to_disparity(depth_m) + noise)
    processor = FrameProcessor(
        PlaneDetector(detector.config, DepthFunction(lambda _: noisy_m, blur_px=_BLUR_PX)),
        NodeConfig(), 'image')
    header = Header()
    frame = Frame(rgb_to_msg(header, rgb),
                  camera_info_to_msg(header, CORRIDOR_LENS), None, None, 0)
    return median_seconds(lambda: processor.process(frame))
