# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""An image with its depth, from a sensor or a model; :func:`make_source` decides which."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import cv2
import numpy as np

from plane_detector.config import Config
from plane_detector.depth.far import has_usable_distance
from plane_detector.depth.readers import lens_factor
from plane_detector.depth.temporal_filter import FilteredDisparity, filter_disparity
from plane_detector.geometry.disparity import (
    DEPTHS,
    UNITLESS,
    limited_depth,
    limited_disparity,
    noise_unit,
    range_and_median,
    to_depth,
    to_disparity,
)
from plane_detector.geometry.rectification import Reduction
from plane_detector.geometry.robust import median
from plane_detector.stage_timer import StageTimer
from plane_detector.types import CameraIntrinsics, DepthModel, Prediction

# Flicker is averaged in an image with sides up to this: a network resolves no finer detail.
_FILTER_SIDE_PX = 640
# Weight of earlier images while nothing moves. tuned: `benchmark flicker` of 119cc6f.
_DAMPING = 0.8
_OF_MODELS = ('output', 'noise_share', 'focal_per_height', 'facts', 'edge_blur_px',
              'predict')


@dataclass(frozen=True)
class Observation:
    """An image with its depth, before the scale is known."""

    rgb: np.ndarray  # (H, W, 3) uint8
    intrinsics: CameraIntrinsics
    config: Config  # settings for this image
    prediction: Prediction  # the input of the segmentation
    is_measured: bool = False  # the prediction is the measurement of a sensor, in metres
    sensor_depth_m: np.ndarray | None = None  # (H, W), may determine the scale of the prediction
    # Standard deviation of the disparity stated for the source, as a share of the disparities of
    # an image; 0: not known.
    noise_share: float = 0.0
    edge_blur_px: float = 0.0  # largest error of depth edges, in pixels of this image
    covered: np.ndarray | None = None  # (H, W) bool, after rectification; None: all
    # (H, W) float32: depth in metres that repeats exactly and is not a measurement, NaN elsewhere;
    # None: there is none
    constants_m: np.ndarray | None = None
    is_still: bool = False  # nothing moved since the previous image: averaged with earlier ones
    input_note: str = ''  # evidence against its stated camera or depth; empty if none
    sees_sky: bool = False  # only found for a network's depth
    stamp_s: float = float('nan')  # time of the image; NaN: unknown
    epoch: int = 0  # images of different epochs share no history
    timer: StageTimer = field(default_factory=StageTimer)  # of the stages on this image

    @property
    def scale_warning(self) -> str:
        """Why its lengths are meaningless; empty without evidence."""
        return ('the network was trained indoors, and the image shows the sky'
                if self.prediction.is_indoor and self.sees_sky else '')

    @property
    def constant_note(self) -> str:
        """How many pixels repeat which depth and are not measurements; empty if none."""
        if self.constants_m is None:
            return ''
        depths_m = self.constants_m[np.isfinite(self.constants_m)]
        near_m, far_m = depths_m.min(), depths_m.max()
        span = f'{near_m:.4g} m' if near_m == far_m else f'{near_m:.4g} to {far_m:.4g} m'
        return (f'{depths_m.size} pixels repeat the depth {span} exactly: they are not '
                'measurements')

    def stated(self, **fields: object) -> Observation:
        """Return the observation with other fields than its prediction, whose disparity stays."""
        other = replace(self, **fields)
        vars(other).update({name: vars(self)[name] for name in ('disparity', 'range_and_median')
                            if name in vars(self)})
        return other

    @cached_property
    def disparity(self) -> np.ndarray:
        """Disparity (H, W) float32, affine in 1/z, NaN invalid."""
        values = self.prediction.values
        return to_disparity(values) if self.prediction.output in DEPTHS else values

    @cached_property
    def range_and_median(self) -> tuple[float, float]:
        """Range, above 0, and median of the disparity."""
        return range_and_median(self.disparity)

    @property
    def disparity_noise(self) -> float:
        """Noise stated for the source, in the unit of the disparity."""
        return self.noise_share and self.noise_share * noise_unit(*self.range_and_median)

    def with_values(self, values: np.ndarray) -> Observation:
        """Return the observation with other values (H, W), of the same kind."""
        if values is self.prediction.values:
            return self
        return replace(self, prediction=replace(self.prediction, values=values))

    def without_constants(self, kept: np.ndarray) -> Observation:
        """Return the observation with the depth (H, W) that is kept, NaN where it repeats."""
        before = self.prediction.values
        if kept is before:
            return self
        constants_m = np.where(np.isnan(kept), before, np.float32(np.nan))
        return replace(self.with_values(kept), constants_m=constants_m)

    def restricted_to(self, covered: np.ndarray) -> Observation:
        """Return the observation, invalid where ``covered`` (H, W) bool is False."""
        values = np.where(covered, self.prediction.values, np.float32(np.nan))
        constants_m = self.constants_m
        if constants_m is not None:
            constants_m = np.where(covered, constants_m, np.float32(np.nan))
            constants_m = constants_m if np.isfinite(constants_m).any() else None
        return replace(self.with_values(values), covered=covered, constants_m=constants_m)


@dataclass(frozen=True)
class DepthFunction:
    """
    A function as a depth model.

    Attributes
    ----------
    function : callable
        Takes rgb (H, W, 3) uint8, returns depth or disparity (H, W) floating, NaN invalid.
    output : str
        Kind of its output, as in :class:`~plane_detector.types.Prediction`.
    noise_share, focal_per_height
        As in :class:`~plane_detector.types.DepthModel`.
    blur_px : float
        Largest error of depth edges, in pixels.

    Examples
    --------
    >>> camera = CameraIntrinsics(3.0, 3.0, 1.0, 0.0, 3, 1)
    >>> wall = DepthFunction(lambda rgb: np.full(rgb.shape[:2], 2.0))
    >>> wall.predict(np.zeros((1, 3, 3), np.uint8), camera)
    Prediction(output='metric_depth', values=array([[2., 2., 2.]]), ...)

    """

    function: Callable[[np.ndarray], np.ndarray]
    output: str = 'metric_depth'
    noise_share: float = 0.0
    focal_per_height: float = 0.0
    blur_px: float = 0.0

    @property
    def facts(self) -> Mapping[str, str]:
        """Name of the function."""
        return {'depth_model': getattr(self.function, '__name__', type(self.function).__name__)}

    def edge_blur_px(self, width: int, height: int) -> float:
        """Return the largest error of depth edges."""
        return self.blur_px

    def predict(self, rgb: np.ndarray, intrinsics: CameraIntrinsics) -> Prediction:
        """Call the function; the intrinsics are not used."""
        return Prediction(self.output, self.function(rgb))


class SensorDepth:
    """Depth source that uses the depth image of a sensor."""

    output = 'metric_depth'
    facts: Mapping[str, str] = {'depth_model': 'the depth topic, no network'}

    def observe(self, rgb: np.ndarray, intrinsics: CameraIntrinsics, depth_m: np.ndarray | None,
                config: Config) -> Observation:
        """Return the observation of depth (H, W) float32, NaN invalid; ValueError without one."""
        if depth_m is None:
            raise ValueError('depth.source is topic or points, but no depth was given')
        prediction = Prediction(self.output, depth_m)
        return Observation(rgb, intrinsics, config, prediction, is_measured=True)

    def reset(self) -> None:
        """Do nothing: no state is kept between frames."""


class ModelDepth:
    """Depth source that uses a model; its flicker is averaged while nothing moves."""

    def __init__(self, model: DepthModel) -> None:
        self.model = model
        self._average: FilteredDisparity | None = None

    @property
    def output(self) -> str:
        """Output of the model."""
        return self.model.output

    @property
    def facts(self) -> Mapping[str, str]:
        """Description of the model for the log and the diagnostics."""
        return self.model.facts

    def observe(self, rgb: np.ndarray, intrinsics: CameraIntrinsics, depth_m: np.ndarray | None,
                config: Config) -> Observation:
        """Return the observation of an image with its prediction, averaged while it is still."""
        prediction, (height, width) = self.model.predict(rgb, intrinsics), rgb.shape[:2]
        # Writable, as kernels require; the values of a function may be a view of its own data.
        output, values = prediction.output, np.require(prediction.values, np.float32, 'CW')
        if values.shape != (height, width):
            raise ValueError(f'depth of shape {values.shape} for an image of shape '
                             f'{(height, width)}: they must be of one size')
        factor = lens_factor(intrinsics, config.scale.reference_focal_px,
                             self.model.focal_per_height)
        if output == 'relative_depth':
            # In units of the median, so that no depth is below the minimum or beyond float32.
            valid = values[np.isfinite(values) & (values > 0)]
            values = values / np.float32(median(valid) if valid.size else 1.0)
        elif output == 'relative_disparity':
            values = np.where(np.isfinite(values), values, np.float32(np.nan))
        if output not in UNITLESS:
            values = values * np.float32(factor if output == 'metric_depth' else 1 / factor)
            limited = limited_depth if output == 'metric_depth' else limited_disparity
            values = limited(values, config.depth.max_depth)
        seen = Observation(rgb, intrinsics, config, replace(prediction, values=values),
                           sensor_depth_m=depth_m, noise_share=self.model.noise_share,
                           edge_blur_px=self.model.edge_blur_px(width, height))
        seen = self._averaged(seen)
        known, sees_sky = has_usable_distance(seen.disparity, seen.disparity_noise, rgb,
                                              output == 'relative_disparity')
        if not known.all():
            seen = seen.with_values(np.where(known, seen.prediction.values, np.nan))
        return seen.stated(sees_sky=sees_sky)

    def reset(self) -> None:
        """Discard the average of earlier frames."""
        self._average = None

    def _averaged(self, seen: Observation) -> Observation:
        """Return the observation with less flicker of the depth."""
        height, width = seen.disparity.shape
        reduction = Reduction.to_side((width, height), _FILTER_SIDE_PX)
        disparity, rgb = seen.disparity, reduction.image(seen.rgb)
        if not reduction.is_none:
            disparity = cv2.resize(disparity, reduction.new_size,
                                   interpolation=cv2.INTER_NEAREST)
        self._average = filter_disparity(self._average, disparity, rgb, _DAMPING,
                                         same_scale=seen.prediction.output not in UNITLESS)
        if self._average.image_count == 1:
            return seen
        values = self._average.disparity
        if not reduction.is_none:
            change = np.nan_to_num(values - disparity, copy=False)
            values = seen.disparity + cv2.resize(change, (width, height))
        return replace(seen.with_values(
            to_depth(values) if seen.prediction.output in DEPTHS else values), is_still=True)


DepthSource = SensorDepth | ModelDepth
ModelOrFunction = DepthModel | Callable[[np.ndarray], np.ndarray]


def make_source(config: Config, model: ModelOrFunction | None) -> DepthSource:
    """
    Return the depth source that the settings and the model determine.

    Parameters
    ----------
    config : Config
        ``depth.source`` decides if no model is given.
    model : DepthModel, callable or None
        A plain function returns the kind of depth given by ``depth.output``; ``auto``: metres.

    Raises
    ------
    ValueError
        The model has only some of the attributes of :class:`~plane_detector.types.DepthModel`, or
        as raised by :class:`~plane_detector.depth.estimator.DepthEstimator`.

    """
    if model is None and config.depth.is_measured:
        return SensorDepth()
    if model is None:
        from plane_detector.depth.estimator import DepthEstimator  # imports ONNX Runtime
        return ModelDepth(DepthEstimator(config.depth))
    if isinstance(model, DepthModel):
        return ModelDepth(model)
    there = [name for name in _OF_MODELS if hasattr(model, name)]
    if there:
        raise ValueError(f'the depth model has {", ".join(there)}, but not '
                         f'{", ".join(name for name in _OF_MODELS if name not in there)}: see '
                         'plane_detector.types.DepthModel, or wrap it in a DepthFunction')
    if not callable(model):
        raise ValueError('the depth model must be a function of the image or a '
                         f'plane_detector.types.DepthModel, not {model!r}')
    output = config.depth.output
    return ModelDepth(DepthFunction(model, 'metric_depth' if output == 'auto' else output))
