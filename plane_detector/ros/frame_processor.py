# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Processing of one frame, from messages to messages: depth, planes, outputs. No DDS."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from std_msgs.msg import Header

from plane_detector.config import NodeConfig
from plane_detector.depth.observation import DepthFunction, ModelDepth
from plane_detector.depth.plausibility import CORRIDOR_LENS, corridor
from plane_detector.geometry.disparity import to_depth, to_disparity
from plane_detector.pipeline import PlaneDetector
from plane_detector.ros.calibration import camera_info_to_msg
from plane_detector.ros.inputs.frame_conversion import FrameConverter
from plane_detector.ros.inputs.synchronizer import Frame, ns_of
from plane_detector.ros.inputs.transforms import CameraPose, FrameTransforms, TransformBuffer
from plane_detector.ros.live_map import LiveMap
from plane_detector.ros.outputs.frame import DetectedFrame, MapView
from plane_detector.ros.outputs.messages import rgb_to_msg
from plane_detector.ros.outputs.topics import MAP_OUTPUTS, OUTPUTS
from plane_detector.stage_timer import StageTimer, median_seconds

# Noise and blur of a network's depth, for timing the stages after it.
_NOISE_PER_M, _BLUR_PX = 0.005, 12.0


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
    live_map : LiveMap, optional
        Gets every image.

    """

    def __init__(self, detector: PlaneDetector, settings: NodeConfig, image_topic: str,
                 transforms: FrameTransforms | None = None, live_map: LiveMap | None = None):
        self.detector = detector
        self.settings = settings
        self._image_topic = image_topic
        self._converter = FrameConverter(image_topic, detector.config.depth)
        self._transforms = transforms or FrameTransforms(TransformBuffer())
        self._map = live_map
        self._epoch = 0

    @property
    def output(self) -> str:
        """Kind of depth that the source returns."""
        return self.detector.source.output

    @property
    def has_network(self) -> bool:
        """Whether the depth is from a network, which takes long."""
        return isinstance(self.detector.source, ModelDepth)

    def process(self, frame: Frame, wanted: Collection[str] = tuple(OUTPUTS)
                ) -> tuple[DetectedFrame, dict[str, Any]]:
        """
        Find the planes of a frame and make the messages of the requested outputs.

        Raises
        ------
        ValueError
            The messages are invalid or do not fit together, or the transform to the base frame is
            missing.

        """
        found = self.begin(frame)()
        return found, make_messages(found, wanted)

    def begin(self, frame: Frame) -> Callable[[], DetectedFrame]:
        """
        Find the depth of a frame, and return a function that finds its planes.

        Both take the frames in order; another thread may call the functions.
        """
        settings, timer = self.settings, StageTimer()
        if frame.epoch != self._epoch:
            self._epoch = frame.epoch
            self.detector.reset()
        with timer('convert'):
            # 1. The messages as arrays.
            converted = self._converter.convert(frame, settings)
            transforms = self._transforms.awaited(frame.image.header, settings)
        # 2. Depth; meanwhile TF may receive the transforms of this image.
        seen = self.detector.estimate_depth(
            converted.rgb, converted.intrinsics, converted.depth_m, converted.covered,
            1e-9 * ns_of(frame.image), timer)

        def find_planes() -> DetectedFrame:
            with timer('wait'):
                pose, to_target, problem = transforms()
            # 3. Gravity and lines, then planes.
            around = self.detector.find_directions(seen, *measured_gravity(frame, pose))
            found = self.detector.find_planes(seen, around, height_m(pose))
            result = DetectedFrame(
                found, seen.intrinsics, to_target, seen.stamp_s, header=frame.image.header,
                rgb=seen.rgb, settings=settings, pose_problem=problem,
                distortion=converted.distortion, timer=timer)
            if self._map is None:
                return result
            with timer('map'):
                # 4. One lasting plane for one surface.
                return replace(result, map_view=self._map.add(result, seen.epoch))
        return find_planes

    def seconds_with(self, max_side: int, frame: Frame, wanted: Collection[str]) -> float:
        """Return the time that a frame would take if its image were reduced to this side first."""
        model = self.detector.source.model if self.has_network else None
        other = FrameProcessor(PlaneDetector(self.detector.config, model),
                               replace(self.settings, max_side=max_side), self._image_topic,
                               self._transforms)
        return median_seconds(lambda: other.process(frame, wanted))


def make_messages(found: DetectedFrame, wanted: Collection[str]) -> dict[str, Any]:
    """Return the messages of some outputs, as far as they are available."""
    with found.timer('messages'):
        return {name: msg for name in wanted
                if not (found.pose_problem and OUTPUTS[name].is_placed)
                and (msg := OUTPUTS[name].make(found)) is not None
                } | make_map_messages(found.map_view)


def make_map_messages(view: MapView | None) -> dict[str, Any]:
    """Return the messages of the map, which are latched: whether anybody listens or not."""
    return {} if view is None else {name: output.make(view)
                                    for name, output in MAP_OUTPUTS.items()}


def placement_problem(found: DetectedFrame, wanted: Collection[str]) -> str:
    """Return why some of the outputs lack their messages; empty if the pose is known."""
    return found.pose_problem if any(OUTPUTS[name].is_placed for name in wanted) else ''


def measured_gravity(frame: Frame, pose: CameraPose | None) -> tuple[np.ndarray | None, str]:
    """Return the direction of gravity from the IMU, else from TF, which cannot see a slope."""
    if frame.gravity_camera is not None or pose is None:
        return frame.gravity_camera, 'imu'
    return pose.gravity_camera, 'tf'


def height_m(pose: CameraPose | None) -> float | None:
    """Return the height of the camera from TF; None if the camera is below the base frame."""
    return pose.height_m if pose is not None and pose.height_m > 0 else None


def fit_to_rate(detector: PlaneDetector) -> None:
    """Choose the largest network input that keeps ``depth.target_rate``, if both are given."""
    rate_hz = detector.config.depth.target_rate
    if rate_hz > 0 and not detector.config.depth.is_measured:
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
