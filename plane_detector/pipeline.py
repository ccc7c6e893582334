# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Image and intrinsics to planes: the recipe, one line a stage."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np

from plane_detector.config import Config
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.depth.focal_correction import lens_factor
from plane_detector.depth.temporal_filter import DampedDisparity, damp_flicker
from plane_detector.geometry.gravity import unit_direction
from plane_detector.planes.classification import PlaneClass, classify_planes, refine_gravity
from plane_detector.scale.estimate import ScaleEstimate, apply_scale, to_disparity
from plane_detector.scale.methods import COARSE_GRAVITY_DEG, estimate_scale
from plane_detector.scale.temporal_filter import ScaleState, update_scale
from plane_detector.segmentation.pixels.edge_snapping import snap_to_picture
from plane_detector.segmentation.segment import (
    Refine,
    disparity_range,
    measure_labels,
    segment_disparity,
    segment_planes,
)
from plane_detector.tracking.tracker import PlaneTracker
from plane_detector.types import CameraIntrinsics, Detection, PlaneSegmentation

EstimateDepth = Callable[[np.ndarray], np.ndarray]
# Edges of a network's depth are off by up to about this many pixels of its input.
BLUR_INPUT_PX = 3.5


class PlaneDetector:
    """
    The whole pipeline.

    Parameters
    ----------
    config : Config, optional
    estimate_depth : callable, optional
        Takes rgb (H, W, 3) uint8 and returns depth or disparity (H, W) float32, NaN invalid. What
        it returns says its attribute ``output``, if it has one, else ``config.depth.output``,
        where ``auto`` means metres. An attribute ``input_size``, a function of width and height
        that returns those of the network's input, says how blurred its depth is. Default: the
        network that ``config.depth`` names.

    """

    def __init__(self, config: Config | None = None,
                 estimate_depth: EstimateDepth | None = None) -> None:
        self.config = config or Config()
        if estimate_depth is None and self.config.depth.source == 'model':
            estimate_depth = DepthEstimator(self.config.depth)
        self.estimate_depth = estimate_depth
        self._damped: DampedDisparity | None = None
        self._scale: ScaleState | None = None
        self._tracker = PlaneTracker()

    def reset(self) -> None:
        """Forget the pictures before: averages, scale and labels start anew."""
        self._damped = self._scale = None
        self._tracker.reset()

    def detect(self, rgb: np.ndarray, intrinsics: CameraIntrinsics,
               depth_m: np.ndarray | None = None, down_camera: np.ndarray | None = None,
               covered: np.ndarray | None = None) -> Detection:
        """
        Find the planes of a picture.

        Parameters
        ----------
        rgb : (H, W, 3) uint8
            Rectified.
        intrinsics : CameraIntrinsics
            Of that picture.
        depth_m : (H, W) floating, optional
            Measured depth of the same picture, NaN invalid. With ``config.depth.source`` ``topic``
            it is what is segmented, and must be there; with ``model`` it may fix the scale.
        down_camera : (3,) floating, optional
            Measured direction of gravity; default: ``config.scale.gravity``.
        covered : (H, W) bool, optional
            Where the picture shows something; rectification leaves corners black, and a network
            has a depth for these too.

        Returns
        -------
        Detection

        Raises
        ------
        ValueError
            Picture, depth and intrinsics do not fit together.

        """
        stages = Stages()
        with stages('depth'):
            prediction, output = self._predict(rgb, intrinsics, depth_m)
            prediction = self._damp(prediction, output, rgb)
            if covered is not None:
                prediction = np.where(covered, prediction, np.float32(np.nan))
        with stages('segmentation'):
            refine = self._snap_to(rgb)
            labels, found = self._segment(prediction, output, intrinsics, refine)
        with stages('scale'):
            scale = self._update_scale(prediction, output, labels, intrinsics, depth_m,
                                       down_camera)
        with stages('measurement'):
            found, scaled_m = found or self._measure(prediction, output, labels, intrinsics,
                                                     scale.estimate, refine)
            classes = self._classify(found, scale.estimate, down_camera)
        with stages('tracking'):
            found, track_labels = self._track(found)
        return Detection(**vars(found), depth_m=scaled_m, scale_method=scale.estimate.unit_method,
                         scale_note=str(scale.estimate), scale_event=scale.event, classes=classes,
                         track_labels=track_labels, stage_seconds=stages.seconds)

    def _snap_to(self, rgb: np.ndarray) -> Refine | None:
        """Return what moves borders to the edges of the picture, where a network blurred them."""
        input_size = getattr(self.estimate_depth, 'input_size', None)
        if not self.config.segmentation.snap_to_picture or input_size is None:
            return None
        height, width = rgb.shape[:2]
        reach_px = BLUR_INPUT_PX * width / input_size(width, height)[0]
        return partial(snap_to_picture, rgb=rgb, reach_px=reach_px)

    def _segment(self, prediction: np.ndarray, output: str, intrinsics: CameraIntrinsics,
                 refine: Refine | None
                 ) -> tuple[np.ndarray, tuple[PlaneSegmentation, np.ndarray] | None]:
        """Return the labels, and the planes too where the prediction is in metres as it is."""
        known = getattr(self.estimate_depth, 'disparity_noise', 0.0)
        if output == 'metric_depth' and self._metres_are_right():
            found = segment_planes(prediction, intrinsics, self.config, disparity_noise=known,
                                   refine=refine)
            return found.labels, (found, prediction)
        disparity = to_disparity(prediction, output)
        known *= disparity_range(disparity) if output == 'relative_disparity' else 1.0
        return segment_disparity(disparity, self.config, disparity_noise=known), None

    def _metres_are_right(self) -> bool:
        return self._is_measured() or self.config.scale.method in ('auto', 'metric')

    def _is_measured(self) -> bool:
        return self.config.depth.source == 'topic' and self.estimate_depth is None

    def _update_scale(self, prediction: np.ndarray, output: str, labels: np.ndarray,
                      intrinsics: CameraIntrinsics, depth_m: np.ndarray | None,
                      down_camera: np.ndarray | None) -> ScaleState:
        """Return what fixes the unit of this picture, given those before."""
        config = self.config.scale
        if self._is_measured():
            config, depth_m = replace(config, method='metric'), None
        measured = estimate_scale(to_disparity(prediction, output), labels, intrinsics, config,
                                  output=output, gravity_camera=down_camera,
                                  sensor_depth_m=depth_m)
        self._scale = update_scale(self._scale, measured, config)
        return self._scale

    def _measure(self, prediction: np.ndarray, output: str, labels: np.ndarray,
                 intrinsics: CameraIntrinsics, scale: ScaleEstimate,
                 refine: Refine | None) -> tuple[PlaneSegmentation, np.ndarray]:
        """Return the planes of known pixels, and the depth, in the unit of the scale."""
        disparity = to_disparity(prediction, output)
        scaled_m = apply_scale(disparity, scale, self.config.depth.max_depth)
        known = getattr(self.estimate_depth, 'disparity_noise', 0.0) * scale.scale
        known *= disparity_range(disparity) if output == 'relative_disparity' else 1.0
        return measure_labels(scaled_m, labels, intrinsics, self.config, known, refine), scaled_m

    def _classify(self, found: PlaneSegmentation, scale: ScaleEstimate,
                  down_camera: np.ndarray | None) -> tuple[PlaneClass, ...]:
        """Tell floor, walls and so on apart, where angles are true and gravity is known."""
        config = self.config.scale
        down = unit_direction(config.gravity if down_camera is None else down_camera)
        if not scale.has_true_angles:
            down = None
        elif down is not None and config.gravity_tolerance > COARSE_GRAVITY_DEG:
            down = refine_gravity(found.planes, down, config.gravity_tolerance)
        return classify_planes(found.planes, down)

    def _track(self, found: PlaneSegmentation) -> tuple[PlaneSegmentation, tuple[int, ...]]:
        if not self.config.tracking.enabled:
            self._tracker.reset()
            return found, ()
        self._tracker.config = self.config.tracking
        return self._tracker.update(found)

    def _predict(self, rgb: np.ndarray, intrinsics: CameraIntrinsics,
                 depth_m: np.ndarray | None) -> tuple[np.ndarray, str]:
        """Return what is segmented and what it means."""
        if self._is_measured():
            if depth_m is None:
                raise ValueError('depth.source is topic, but no depth image was given')
            return self._within_max_depth(np.asarray(depth_m, np.float32)), 'metric_depth'
        output = getattr(self.estimate_depth, 'output', self.config.depth.output)
        if isinstance(self.estimate_depth, DepthEstimator):
            self.estimate_depth.max_depth_m = self.config.depth.max_depth
        prediction = np.asarray(self.estimate_depth(rgb), np.float32)
        if prediction.shape != rgb.shape[:2]:
            raise ValueError(f'depth of shape {prediction.shape} for a picture of shape '
                             f'{rgb.shape[:2]}: they must be of one size')
        output = 'metric_depth' if output == 'auto' else output
        prediction = self._without_lens(prediction, output, intrinsics)
        if output == 'metric_depth':
            prediction = self._within_max_depth(prediction)
        return prediction, output

    def _damp(self, prediction: np.ndarray, output: str, rgb: np.ndarray) -> np.ndarray:
        """Return what a network says with less flicker; measured depth stays as it is."""
        keep = self.config.depth.damping
        if keep == 0 or self._is_measured():
            self._damped = None
            return prediction
        self._damped = damp_flicker(self._damped, to_disparity(prediction, output), rgb, keep,
                                    same_scale=output != 'relative_disparity')
        if self._damped.pictures == 1:
            return prediction
        return to_disparity(self._damped.disparity, output)  # 1/z undoes itself

    def _without_lens(self, prediction: np.ndarray, output: str,
                      intrinsics: CameraIntrinsics) -> np.ndarray:
        """Correct metres for another lens than that of the network's training."""
        factor = lens_factor(intrinsics, self.config.scale.reference_focal_px,
                             getattr(self.estimate_depth, 'focal_per_height', 0.0))
        if output == 'relative_disparity' or factor == 1.0:
            return prediction
        return prediction * np.float32(factor if output == 'metric_depth' else 1 / factor)

    def _within_max_depth(self, depth_m: np.ndarray) -> np.ndarray:
        return np.where(depth_m <= self.config.depth.max_depth, depth_m, np.float32(np.nan))


class Stages:
    """Takes the time of named stages."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Time what is done within."""
        start = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - start
