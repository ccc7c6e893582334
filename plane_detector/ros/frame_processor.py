# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Processing of one frame, from messages to messages: depth, planes, outputs. No DDS."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Any

import numpy as np

from plane_detector.config import NodeConfig
from plane_detector.depth.observation import ModelDepth
from plane_detector.pipeline import PlaneDetector
from plane_detector.ros.inputs.frame_conversion import FrameConverter
from plane_detector.ros.inputs.synchronizer import Frame, ns_of
from plane_detector.ros.inputs.transforms import CameraPose, FrameTransforms, TransformBuffer
from plane_detector.ros.live_map import LiveMap
from plane_detector.ros.outputs.frame import DetectedFrame
from plane_detector.ros.outputs.topics import OUTPUTS, make_map_messages
from plane_detector.stage_timer import StageTimer


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
        self.map = live_map
        self._epoch = 0

    @property
    def has_network(self) -> bool:
        """Whether depth comes from a network, which takes long."""
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
        view = self.map.due_view() if self.map else None
        return found, make_messages(found, wanted) | make_map_messages(view)

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
        observation = self.detector.estimate_depth(
            converted.rgb, converted.intrinsics, converted.depth_m, converted.covered,
            1e-9 * ns_of(frame.image), timer)

        def find_planes() -> DetectedFrame:
            with timer('wait'):
                pose, to_target, problem = transforms()
            # 3. Gravity and lines, then planes.
            surroundings = self.detector.find_directions(observation,
                                                         *measured_gravity(frame, pose))
            found = self.detector.find_planes(observation, surroundings, pose and pose.height_m)
            if frame.imu_problem:
                found = replace(found, input_note='; '.join(filter(None, (
                    found.input_note, frame.imu_problem))))
            result = DetectedFrame(
                found, observation.intrinsics, to_target, observation.stamp_s,
                header=frame.image.header,
                rgb=observation.rgb, settings=settings, config=observation.config,
                to_base=pose and pose.to_base, pose_problem=problem,
                distortion=converted.distortion, timer=timer)
            if self.map is not None:
                with timer('map'):
                    # 4. One persistent plane per surface.
                    self.map.add(result, observation.epoch)
            return result
        return find_planes


def make_messages(found: DetectedFrame, wanted: Collection[str]) -> dict[str, Any]:
    """Return the messages of some outputs, as far as they are available."""
    with found.timer('messages'):
        return {name: msg for name in wanted
                if not (found.pose_problem and OUTPUTS[name].is_placed)
                and (msg := OUTPUTS[name].make(found)) is not None}


def placement_problem(found: DetectedFrame, wanted: Collection[str]) -> str:
    """Return why some of the outputs lack their messages; empty if the pose is known."""
    return found.pose_problem if any(OUTPUTS[name].is_placed for name in wanted) else ''


def measured_gravity(frame: Frame, pose: CameraPose | None) -> tuple[np.ndarray | None, str]:
    """Return the direction of gravity from the IMU, else from TF, which cannot see a slope."""
    if frame.gravity_camera is not None or pose is None:
        return frame.gravity_camera, 'imu'
    return pose.gravity_camera, 'tf'
