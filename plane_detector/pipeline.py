# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Image and intrinsics to planes: the recipe, one line a stage."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from plane_detector.config import Config
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.depth.focal_correction import lens_factor
from plane_detector.depth.temporal_filter import DampedDisparity, damp_flicker
from plane_detector.geometry.disparity import disparity_range, to_depth, to_disparity
from plane_detector.geometry.gravity import unit_direction
from plane_detector.geometry.projection import check_depth
from plane_detector.planes.classification import PlaneClass, classify_planes, refine_gravity
from plane_detector.planes.measurement import measure_planes
from plane_detector.scale.estimate import ScaleEstimate, apply_scale
from plane_detector.scale.methods import COARSE_GRAVITY_DEG, estimate_scale
from plane_detector.scale.temporal_filter import ScaleState, update_scale
from plane_detector.segmentation.baselines import segment_by_paper
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.pixel_regions import PixelRegions
from plane_detector.segmentation.pixels.edge_snapping import GuideImage
from plane_detector.segmentation.segment import metric_noise_floor, segment, unitless_noise_floor
from plane_detector.segmentation.threads import one_blas_thread
from plane_detector.shapes.detector import ShapeDetector
from plane_detector.stage_timer import StageTimer
from plane_detector.tracking.tracker import PlaneTracker
from plane_detector.types import CameraIntrinsics, Detection, Plane, PlaneSegmentation

EstimateDepth = Callable[[np.ndarray], np.ndarray]
DEFAULTS = Config()
# Edges of a network's depth are off by up to about this many pixels of its input.
BLUR_INPUT_PX = 3.5


class PlaneDetector:
    """
    The whole pipeline.

    Parameters
    ----------
    config : Config, optional
    estimate_depth : callable, optional
        Takes rgb (H, W, 3) uint8 and returns depth or disparity (H, W) float32, NaN invalid, as
        its attribute ``output`` or ``config.depth.output`` states. An attribute ``input_size``, a
        function of width and height, states how blurred it is. Default: the network that
        ``config.depth`` names.

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
        self._shapes = ShapeDetector()

    def reset(self) -> None:
        """Forget the pictures before: averages, scale and labels start anew."""
        self._damped = self._scale = None
        self._tracker.reset()
        self._shapes.reset()

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
        stages = StageTimer()
        with stages('depth'):
            prediction, output = self._predict(rgb, intrinsics, depth_m)
            prediction = self._damp(prediction, output, rgb)
            if covered is not None:
                prediction = np.where(covered, prediction, np.float32(np.nan))
            check_depth(prediction, intrinsics)
        with stages('segmentation'):
            regions = self._segment(prediction, output, intrinsics, rgb)
        with stages('scale'):
            scale = self._update_scale(prediction, output, regions.labels, intrinsics, depth_m,
                                       down_camera)
        with stages('measurement'):
            scaled_m = self._in_metres(prediction, output, scale.estimate)
            regions = regions.rescaled(scale.estimate.scale, scale.estimate.shift)
            planes = _measured(regions.restricted_to(scaled_m > 0), intrinsics, self.config)
        with stages('shapes'):
            planes, shapes, names = self._shapes.detect(
                scaled_m, planes, regions, intrinsics, self.config, scale.estimate.is_metric)
            classes = self._classify(planes.planes, scale.estimate, down_camera)
        with stages('tracking'):
            planes, track_labels = self._track(planes)
        return Detection(planes.planes, planes.labels, planes.disparity_noise, scaled_m,
                         scale.estimate.unit_method, scale_note=str(scale.estimate),
                         scale_event=scale.event, classes=classes, track_labels=track_labels,
                         shapes=shapes, shape_labels=names,
                         stage_seconds=stages.seconds)

    def _segment(self, prediction: np.ndarray, output: str, intrinsics: CameraIntrinsics,
                 rgb: np.ndarray) -> PixelRegions:
        disparity = _as_disparity(prediction, output)
        known = getattr(self.estimate_depth, 'disparity_noise', 0.0)
        if output == 'metric_depth':
            noise_floor = metric_noise_floor(self.config, known)
        else:
            known *= disparity_range(disparity) if output == 'relative_disparity' else 1.0
            noise_floor = unitless_noise_floor(disparity, known)
        if self.config.segmentation.method == 'paper' and output == 'relative_disparity':
            raise ValueError('segmentation.method paper needs depth in metres, but the network '
                             'gives relative_disparity')
        return _segment_as_configured(disparity, intrinsics, noise_floor, self.config,
                                      guide=self._guide(rgb))

    def _guide(self, rgb: np.ndarray) -> GuideImage | None:
        """Return what borders snap to, where a network blurred them."""
        input_size = getattr(self.estimate_depth, 'input_size', None)
        if not self.config.segmentation.snap_to_picture or input_size is None:
            return None
        return GuideImage(rgb, BLUR_INPUT_PX * rgb.shape[1] / input_size(*rgb.shape[1::-1])[0])

    def _is_measured(self) -> bool:
        return self.config.depth.source == 'topic' and self.estimate_depth is None

    def _update_scale(self, prediction: np.ndarray, output: str, labels: np.ndarray,
                      intrinsics: CameraIntrinsics, depth_m: np.ndarray | None,
                      down_camera: np.ndarray | None) -> ScaleState:
        """Return what fixes the unit of this picture, given those before."""
        config = self.config.scale
        if self._is_measured():
            config, depth_m = replace(config, method='metric'), None
        measured = estimate_scale(_as_disparity(prediction, output), labels, intrinsics, config,
                                  output=output, gravity_camera=down_camera,
                                  sensor_depth_m=depth_m)
        note = 'measured depth' if self._is_measured() else measured.note
        self._scale = update_scale(self._scale, replace(measured, note=note), config)
        return self._scale

    def _in_metres(self, prediction: np.ndarray, output: str, scale: ScaleEstimate) -> np.ndarray:
        """Return the depth (H, W) float32 in the unit of the scale, NaN invalid."""
        if output == 'metric_depth' and (scale.scale, scale.shift) == (1.0, 0.0):
            return prediction
        return apply_scale(_as_disparity(prediction, output), scale, self.config.depth.max_depth)

    def _classify(self, planes: tuple[Plane, ...], scale: ScaleEstimate,
                  down_camera: np.ndarray | None) -> tuple[PlaneClass, ...]:
        """Tell floor, walls and so on apart, where angles are true and gravity is known."""
        config = self.config.scale
        down = unit_direction(config.gravity if down_camera is None else down_camera)
        if not scale.has_true_angles:
            down = None
        elif down is not None and config.gravity_tolerance > COARSE_GRAVITY_DEG:
            down = refine_gravity(planes, down, config.gravity_tolerance)
        return classify_planes(planes, down)

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
        self._damped = damp_flicker(self._damped, _as_disparity(prediction, output), rgb, keep,
                                    same_scale=output != 'relative_disparity')
        if self._damped.pictures == 1:
            return prediction
        damped = self._damped.disparity
        return to_depth(damped) if output == 'metric_depth' else damped

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


@one_blas_thread
def segment_planes(depth_m: np.ndarray, intrinsics: CameraIntrinsics, config: Config | None = None,
                   *, disparity_noise: float = 0.0,
                   rng: np.random.Generator | None = None) -> PlaneSegmentation:
    """
    Find the planes of a depth image and label its pixels.

    Parameters
    ----------
    depth_m : (H, W) floating
        Metres along the optical axis; NaN, infinity and less than 1 mm are invalid.
    intrinsics : CameraIntrinsics
        Of an image of that size.
    config : Config, optional
        Its ``segmentation``, ``ransac``, ``dbscan`` and ``paper`` are used.
    disparity_noise : float
        What the source of the depth is known for, per metre; 0 when nothing is known. The noise
        is estimated from the image and taken to be at least this.
    rng : numpy.random.Generator, optional
        Default: seeded with ``config.ransac.seed``.

    Returns
    -------
    PlaneSegmentation
        The planes, largest first, and the labels. Finding no plane is not an error.

    Raises
    ------
    ValueError
        ``depth_m`` is not a 2-D floating point array, or its size differs from the intrinsics.

    """
    config = config or DEFAULTS
    check_depth(depth_m, intrinsics)
    regions = _segment_as_configured(to_disparity(depth_m), intrinsics,
                                     metric_noise_floor(config, disparity_noise), config, rng)
    return _measured(regions, intrinsics, config)


def _segment_as_configured(disparity: np.ndarray, intrinsics: CameraIntrinsics,
                           noise_floor: Noise, config: Config,
                           rng: np.random.Generator | None = None,
                           guide: GuideImage | None = None) -> PixelRegions:
    """Segment by the method that the settings name."""
    if config.segmentation.method == 'paper':
        return segment_by_paper(disparity, intrinsics, noise_floor, config, rng)
    return segment(disparity, noise_floor, config, rng, guide)


@one_blas_thread
def _measured(regions: PixelRegions, intrinsics: CameraIntrinsics,
              config: Config) -> PlaneSegmentation:
    """Measure the planes that are large enough."""
    min_pixels = config.segmentation.min_plane_share * regions.labels.size
    planes, labels = measure_planes(regions, intrinsics, min_pixels)
    return PlaneSegmentation(planes, labels, regions.noise.mean)


def _as_disparity(prediction: np.ndarray, output: str) -> np.ndarray:
    return to_disparity(prediction) if output == 'metric_depth' else prediction
