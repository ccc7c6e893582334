# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Image and intrinsics to planes: the recipe, one line a stage."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from plane_detector.config import Config
from plane_detector.depth import DepthEstimator
from plane_detector.scale import estimate_scale
from plane_detector.scale_estimate import apply_scale
from plane_detector.segmentation import measure_labels, segment_disparity, segment_planes
from plane_detector.tracking import PlaneTracker
from plane_detector.types import CameraIntrinsics, Detection, PlaneSegmentation

EstimateDepth = Callable[[np.ndarray], np.ndarray]


class PlaneDetector:
    """
    The whole pipeline.

    Parameters
    ----------
    config : Config, optional
    estimate_depth : callable, optional
        Takes rgb (H, W, 3) uint8 and returns depth or disparity (H, W) float32, NaN invalid. What
        it returns says its attribute ``output``, if it has one, else ``config.depth.output``,
        where ``auto`` means metres. Default: the network that ``config.depth`` names.

    """

    def __init__(self, config: Config | None = None,
                 estimate_depth: EstimateDepth | None = None) -> None:
        self.config = config or Config()
        if estimate_depth is None and self.config.depth.source == 'model':
            estimate_depth = DepthEstimator(self.config.depth)
        self.estimate_depth = estimate_depth
        self._tracker = PlaneTracker()

    def reset(self) -> None:
        """Forget the pictures before: the labels start anew."""
        self._tracker.reset()

    def detect(self, rgb: np.ndarray, intrinsics: CameraIntrinsics,
               depth_m: np.ndarray | None = None) -> Detection:
        """
        Find the planes of a picture.

        Parameters
        ----------
        rgb : (H, W, 3) uint8
            Rectified.
        intrinsics : CameraIntrinsics
            Of that picture.
        depth_m : (H, W) floating, optional
            Measured depth of the same picture, needed when ``config.depth.source`` is ``topic``.

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
            prediction, output = self._predict(rgb, depth_m)
        if output == 'metric_depth':
            with stages('segmentation'):
                found = segment_planes(prediction, intrinsics, self.config,
                                       disparity_noise=self._known_noise())
            with stages('tracking'):
                found, track_labels = self._track(found)
            return Detection(**vars(found), depth_m=prediction, scale_method='metric',
                             stage_seconds=stages.seconds, track_labels=track_labels)
        with stages('segmentation'):
            labels = segment_disparity(prediction, self.config,
                                       disparity_noise=self._known_noise())
        with stages('scale'):
            scale = estimate_scale(prediction, labels, intrinsics, self.config.scale,
                                   output=output)
            scaled_m = apply_scale(prediction, scale, self.config.depth.max_depth)
        with stages('measurement'):
            found = measure_labels(scaled_m, labels, intrinsics, self.config)
        with stages('tracking'):
            found, track_labels = self._track(found)
        return Detection(**vars(found), depth_m=scaled_m, scale_method=scale.method,
                         stage_seconds=stages.seconds, track_labels=track_labels)

    def _track(self, found: PlaneSegmentation) -> tuple[PlaneSegmentation, tuple[int, ...]]:
        if not self.config.tracking.enabled:
            self._tracker.reset()
            return found, ()
        self._tracker.config = self.config.tracking
        return self._tracker.update(found)

    def _predict(self, rgb: np.ndarray, depth_m: np.ndarray | None) -> tuple[np.ndarray, str]:
        """Return what is segmented and what it means."""
        if self.config.depth.source == 'topic' and self.estimate_depth is None:
            if depth_m is None:
                raise ValueError('depth.source is topic, but no depth image was given')
            return np.asarray(depth_m, np.float32), 'metric_depth'
        output = getattr(self.estimate_depth, 'output', self.config.depth.output)
        prediction = np.asarray(self.estimate_depth(rgb), np.float32)
        if prediction.shape != rgb.shape[:2]:
            raise ValueError(f'depth of shape {prediction.shape} for a picture of shape '
                             f'{rgb.shape[:2]}: they must be of one size')
        return prediction, 'metric_depth' if output == 'auto' else output

    def _known_noise(self) -> float:
        return getattr(self.estimate_depth, 'disparity_noise', 0.0)


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
