# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
From image and intrinsics to planes: the stages of the pipeline in order, for a stream of images.

:class:`PlaneDetector` holds all state that carries over from image to image. Each of its three
calls has its own state, and the epoch in which that is valid; an image of a later epoch, after a
reset or a jump back in time, starts the state of each stage anew.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

import numpy as np

from plane_detector._runtime.compilation import load_once
from plane_detector._runtime.process import one_thread
from plane_detector.config import Config
from plane_detector.depth.observation import (
    DepthSource,
    ModelDepth,
    ModelOrFunction,
    Observation,
    make_source,
)
from plane_detector.depth.ray_distance import kind_note
from plane_detector.directions.finder import CameraImage, DirectionFinder, Surroundings
from plane_detector.geometry.disparity import to_disparity
from plane_detector.geometry.gravity import measured_direction, sign_question
from plane_detector.geometry.projection import as_depth, as_image
from plane_detector.ground.ground import find_ground
from plane_detector.ground.sensor_reach import NO_REACH, SensorReach
from plane_detector.network_steps import NetworkSteps
from plane_detector.planes.history import NO_HISTORY, PlaneHistory
from plane_detector.planes.measurement import measured_segmentation
from plane_detector.segmentation.baselines import segment_by_paper
from plane_detector.segmentation.cells.discarded import without_constants
from plane_detector.segmentation.cells.grid import lens_of
from plane_detector.segmentation.cells.model import PixelRegions
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.memory import NO_MEMORY, Memory
from plane_detector.segmentation.segment import metric_noise_floor, segment_next
from plane_detector.shapes.detector import ShapeDetector
from plane_detector.stage_timer import StageTimer
from plane_detector.tracking.tracker import PlaneTracker
from plane_detector.types import (
    JUMP_S,
    METRIC,
    NO_GRAVITY,
    NO_SHAPE_LABELS,
    CameraIntrinsics,
    Detection,
    PlaneSegmentation,
    ScaleEstimate,
)

DEFAULTS = Config()
# Folders of the kernels that every image needs.
LOOPS = ('geometry', 'segmentation', 'planes', 'ground')
# chosen: the kind of depth is tested in images 1, 2, 4, ... up to this, then once in this many.
_KIND_IMAGES = 64
State = TypeVar('State')


class _PerEpochState(Generic[State]):
    """State of a stage, created anew for the first image of an epoch."""

    def __init__(self, make: Callable[[], State]) -> None:
        self._make, self._epoch, self._state = make, 0, make()

    def at(self, epoch: int) -> State:
        """Return the state for an image."""
        if epoch != self._epoch:
            self._epoch, self._state = epoch, self._make()
        return self._state


@dataclass
class _KindNote:
    """Result of the test of the kind of measured depth, which is made ever more rarely: 4 ms."""

    images: int = 0
    text: str = ''

    def of_next(self, depth_m: np.ndarray, intrinsics: CameraIntrinsics, kind: str) -> str:
        """Return the note for the next image of a stream."""
        self.images += 1
        is_power_of_two = not self.images & (self.images - 1)
        if is_power_of_two or not self.images % _KIND_IMAGES:
            self.text = kind_note(depth_m, intrinsics, kind) or (
                '' if self.images % _KIND_IMAGES == 0 else self.text)
        return self.text


class _MeasuredSteps:
    """The steps from a sensor's depth in metres to planes, like `NetworkSteps`."""

    loops: tuple[str, ...] = ()

    def __init__(self) -> None:
        self._memory = NO_MEMORY
        self._event = f'scale: {METRIC}'

    def segment(self, observation: Observation, config: Config) -> PixelRegions:
        before = self._memory if config.segmentation.memory else NO_MEMORY
        regions, self._memory = _find_regions(
            observation.disparity, observation.intrinsics, config, metric_noise_floor(config),
            memory=before)
        return regions

    def scale(self, *_: object) -> tuple[ScaleEstimate, str]:
        event, self._event = self._event, ''
        return METRIC, event

    def measure(self, observation: Observation, regions: PixelRegions, scale: ScaleEstimate,
                surroundings: Surroundings, config: Config
                ) -> tuple[np.ndarray, PixelRegions, PlaneSegmentation]:
        return observation.prediction.values, regions, measured_segmentation(
            regions, observation.intrinsics, config.segmentation.min_plane_share)

    def fill(self, planes: PlaneSegmentation, *_: object) -> np.ndarray:
        return planes.labels


@dataclass
class _PlaneState:
    """State of the third stage that does not depend on the source of depth."""

    tracker: PlaneTracker = field(default_factory=PlaneTracker)
    shapes: ShapeDetector = field(default_factory=ShapeDetector)
    reach: SensorReach = NO_REACH
    history: PlaneHistory = NO_HISTORY


class PlaneDetector:
    """
    The whole pipeline, for one stream of images.

    Parameters
    ----------
    config : Config, optional
    depth_model : DepthModel or callable, optional
        Takes rgb (H, W, 3) uint8, returns depth or disparity (H, W) float32, NaN invalid, as in
        ``config.depth.output`` (``auto``: metres). Default: the network of ``config.depth``.

    Attributes
    ----------
    config : Config
        May be replaced between two images.
    source : DepthSource

    Examples
    --------
    >>> camera = CameraIntrinsics.from_field_of_view(160, 120, 60.0)
    >>> detector = PlaneDetector(depth_model=lambda rgb: np.full(rgb.shape[:2], 2.0, np.float32))
    >>> detection = detector.detect(np.zeros((120, 160, 3), np.uint8), camera)
    >>> [round(plane.offset_m, 3) for plane in detection.planes], str(detection.scale)
    ([2.0], 'metric: metres of the network')

    """

    def __init__(self, config: Config | None = None,
                 depth_model: ModelOrFunction | None = None) -> None:
        self.config = _checked_config(config)
        self.source: DepthSource = make_source(self.config, depth_model)
        self._epoch = self._depth_epoch = 0
        self._stamp_s = float('nan')
        self._kinds = _PerEpochState(_KindNote)
        self._directions = _PerEpochState(DirectionFinder)
        self._steps: _PerEpochState[_MeasuredSteps | NetworkSteps] = _PerEpochState(
            NetworkSteps if isinstance(self.source, ModelDepth) else _MeasuredSteps)
        self._planes = _PerEpochState(_PlaneState)

    def detect(self, rgb: np.ndarray, intrinsics: CameraIntrinsics,
               depth_m: np.ndarray | None = None, gravity_camera: np.ndarray | None = None,
               covered: np.ndarray | None = None, *, stamp_s: float = float('nan'),
               camera_height_m: float | None = None) -> Detection:
        """
        Find the planes of the next image.

        Parameters
        ----------
        rgb : (H, W, 3) uint8
            Rectified.
        intrinsics : CameraIntrinsics
            Of that image.
        depth_m : (H, W) floating, optional
            Measured depth of the same image in metres, of ``config.depth.kind``; NaN, infinity,
            less than 1 mm and more than ``config.depth.max_depth`` are invalid. With
            ``config.depth.source`` ``topic`` it is required and is segmented; with ``model`` it
            may determine the scale.
        gravity_camera : (3,) floating, optional
            Measured, not all 0; default: ``config.scale.gravity``.
        covered : (H, W) bool, optional
            False in the black corners that rectification leaves; depth is invalid there.
        stamp_s : float
            Time of the image. If it jumps back, all history is discarded. Without it, lines are
            detected in every image that needs them, even while nothing moves.
        camera_height_m : float, optional
            Measured height above the floor, 0 if unknown; default: ``config.scale.camera_height``.

        Returns
        -------
        Detection

        Raises
        ------
        ValueError
            An argument has another type, size or range than stated here, or a required depth
            image is missing.

        """
        observation = self.estimate_depth(rgb, intrinsics, depth_m, covered, stamp_s)
        with one_thread():
            surroundings = self.find_directions(observation, gravity_camera)
            return self.find_planes(observation, surroundings, camera_height_m)

    def estimate_depth(self, rgb: np.ndarray, intrinsics: CameraIntrinsics,
                       depth_m: np.ndarray | None = None, covered: np.ndarray | None = None,
                       stamp_s: float = float('nan'), timer: StageTimer | None = None
                       ) -> Observation:
        """
        Run the first stage of :meth:`detect`: the depth of an image.

        Another thread may run the next two stages for earlier images, in order. They add their
        times to the ``timer`` of the observation.
        """
        rgb, timer = as_image(rgb, intrinsics), timer or StageTimer()
        if depth_m is not None:
            depth_m = as_depth(depth_m, intrinsics, self.config.depth.max_depth,
                               self.config.depth.kind)
        if covered is not None:
            covered = _checked_cover(covered, rgb.shape[:2])
        stamp_s = _as_number('stamp_s', stamp_s)
        if math.isinf(stamp_s):
            raise ValueError(f'stamp_s must be finite, or NaN if it is not known, not {stamp_s}')
        if stamp_s < self._stamp_s - JUMP_S:
            self._epoch += 1
        epoch, self._stamp_s = self._epoch, stamp_s
        if epoch != self._depth_epoch:
            self._depth_epoch = epoch
            self.source.reset()
        notes = [intrinsics.question]
        if depth_m is not None:
            notes.append(self._kinds.at(epoch).of_next(depth_m, intrinsics,
                                                       self.config.depth.kind))
        with timer('depth'):
            observation = self.source.observe(rgb, intrinsics, depth_m, self.config)
            if observation.is_measured:
                observation = observation.without_constants(without_constants(
                    observation.prediction.values, metric_noise_floor(self.config)))
            if covered is not None:
                observation = observation.restricted_to(covered)
        return observation.stated(stamp_s=stamp_s, epoch=epoch, timer=timer,
                                  input_note=_joined(notes))

    def find_directions(self, observation: Observation, gravity_camera: np.ndarray | None = None,
                        gravity_source: str = 'measured') -> Surroundings:
        """
        Run the second stage: gravity and lines.

        The last lines are kept while nothing moves. ``gravity_source`` names the source of the
        measured direction of gravity.
        """
        if gravity_camera is not None:
            gravity_camera = measured_direction(gravity_camera)
        image = CameraImage(observation.rgb, observation.intrinsics, observation.covered,
                            observation.disparity,
                            observation.prediction.output == 'relative_disparity',
                            observation.stamp_s,
                            is_measured=observation.is_measured,
                            is_lens_guessed=observation.intrinsics.is_guessed,
                            is_still=observation.is_measured or observation.is_still)
        with observation.timer('directions'), one_thread():
            return self._directions.at(observation.epoch).find(
                image, gravity_camera, observation.config, gravity_source,
                for_planes=(observation.config.directions.orient_planes
                            and not observation.is_measured))

    @one_thread()
    def find_planes(self, observation: Observation, surroundings: Surroundings,
                    camera_height_m: float | None = None) -> Detection:
        """Run the third stage of :meth:`detect`: the planes of an image with depth."""
        config, timer = _with_height(observation.config, camera_height_m), observation.timer
        state, steps = self._planes.at(observation.epoch), self._steps.at(observation.epoch)
        with timer('segmentation'):
            # 1. The pixels of each plane, in the unit of the prediction.
            load_once(*LOOPS, *steps.loops)
            regions = steps.segment(observation, config)
        with timer('scale'):
            # 2. The scale and shift to metres, smoothed over time.
            scale, scale_event = steps.scale(observation, regions, surroundings, config)
        with timer('measurement'):
            # 3. Depth and planes in metres, or in an arbitrary unit if the scale is unknown.
            depth_m, regions, planes = steps.measure(observation, regions, scale, surroundings,
                                                     config)
        with timer('shapes'):
            # 4. Spheres, cylinders and cones where there is no plane, if requested.
            shapes, shape_labels = (), NO_SHAPE_LABELS
            shape_note = ('shapes.types is none' if not config.shapes.wanted else
                          '' if scale.is_metric else 'the unit of depth is not known')
            if not shape_note:
                planes, shapes, shape_labels = state.shapes.detect(
                    depth_m, planes, regions, observation.intrinsics, config)
        with timer('tracking'):
            # 5. Labels that persist from image to image, and averages over them.
            planes = state.tracker.update(planes, config.tracking)
            remembers = config.segmentation.memory and config.tracking.enabled
            past = (state.history if remembers else NO_HISTORY).of(
                planes.planes, observation.intrinsics)
            planes = replace(planes, planes=replace(
                planes.planes, confidences=past.mean_confidences(planes.planes)))
        with timer('ground'):
            # 6. Own floor, ramps, obstacles and drops, if angles are true and gravity is known.
            gravity = surroundings.gravity if scale.has_true_angles else NO_GRAVITY
            surfaces = (planes if gravity.gravity_camera is None else
                        _with_facets(planes, regions, observation.intrinsics, config))
            ground = find_ground(surfaces, depth_m, observation.intrinsics, gravity, config,
                                 state.reach, plane_count=len(planes.planes),
                                 is_metric=scale.is_metric,
                                 doubt=observation.scale_warning,
                                 constants_m=observation.constants_m, past=past)
            state.reach = ground.reach
            if ground.fronts is not None:
                depth_m = np.where(ground.fronts, observation.constants_m, depth_m)
            planes = replace(planes, planes=replace(
                planes.planes, classes=ground.classes[:len(planes.planes)]))
            state.history = (ground.past.after(planes.planes) if remembers else NO_HISTORY)
            self._directions.at(observation.epoch).note_planes(planes, is_trusted=(
                observation.is_measured and surroundings.gravity.gravity_camera is not None))
        with timer('patches'):
            # 7. Unlabelled pixels, if colours show the ends of surfaces better than depth.
            labels = steps.fill(planes, regions, depth_m, observation, shape_labels)
        input_note = _joined([observation.input_note, _sign_note(planes, surroundings, scale)])
        return Detection(planes.planes, labels, planes.disparity_noise, depth_m, scale,
                         systematic_noise=planes.systematic_noise, plane_note=planes.plane_note,
                         gravity=surroundings.gravity, ground_result=ground.result,
                         is_measured=observation.is_measured,
                         constant_note=_joined([observation.constant_note,
                                                ground.constant_note]), input_note=input_note,
                         scale_event=scale_event, shapes=shapes,
                         shape_labels=shape_labels, shape_note=shape_note,
                         stage_seconds=timer.seconds)

    def reset(self) -> None:
        """
        Discard the state from earlier images before the next one; from any thread.

        The state consists of averages of depth, lines, scale, planes and labels.
        """
        self._epoch += 1


def segment_planes(depth_m: np.ndarray, intrinsics: CameraIntrinsics, config: Config | None = None,
                   *, disparity_noise: float = 0.0,
                   rng: np.random.Generator | None = None) -> PlaneSegmentation:
    """
    Find the planes of a depth image and label its pixels.

    Parameters
    ----------
    depth_m : (H, W) floating
        Metres, of ``config.depth.kind``; NaN, infinity, less than 1 mm and more than
        ``config.depth.max_depth`` are invalid, as for :meth:`PlaneDetector.detect`.
    intrinsics : CameraIntrinsics
        Of an image of that size.
    config : Config, optional
        Its ``segmentation``, ``ransac``, ``dbscan`` and ``paper`` are used, and of ``depth`` the
        kind and ``max_depth``.
    disparity_noise : float
        Standard deviation stated for the depth source, 1/m; a lower bound of the estimate.
    rng : numpy.random.Generator, optional
        Default: seeded with ``config.ransac.seed``.

    Returns
    -------
    PlaneSegmentation
        The planes, largest first, and the labels. Finding no plane is not an error.

    Raises
    ------
    ValueError
        ``depth_m`` is not a 2-D floating point array, its size differs from the intrinsics, or the
        noise or the generator is invalid.

    Examples
    --------
    A wall 2 m ahead:

    >>> camera = CameraIntrinsics.from_field_of_view(160, 120, 60.0)
    >>> found = segment_planes(np.full((120, 160), 2.0), camera)
    >>> found.planes[0].normal.round(3) + 0.0
    array([ 0.,  0., -1.])
    >>> round(found.planes[0].offset_m, 3), bool((found.labels == 0).all())
    (2.0, True)

    """
    config = _checked_config(config)
    depth_m = as_depth(depth_m, intrinsics, config.depth.max_depth, config.depth.kind)
    disparity_noise = _as_number('disparity_noise', disparity_noise)
    if not 0 <= disparity_noise < math.inf:
        raise ValueError('disparity_noise must be a standard deviation in 1/m, 0 if it is not '
                         f'known, not {disparity_noise}')
    if not (rng is None or isinstance(rng, np.random.Generator)):
        raise ValueError(f'rng must be a numpy.random.Generator, not {rng!r}: of a seed, '
                         'np.random.default_rng(seed)')
    load_once(*LOOPS)
    with one_thread():
        if disparity_noise == 0:
            depth_m = without_constants(depth_m, metric_noise_floor(config))
        regions, _ = _find_regions(to_disparity(depth_m), intrinsics, config,
                                   metric_noise_floor(config, disparity_noise), rng)
        return measured_segmentation(regions, intrinsics, config.segmentation.min_plane_share)


def _checked_config(config: Config | None) -> Config:
    if config is not None and not isinstance(config, Config):
        raise ValueError('config must be a plane_detector.Config, as Config(depth=DepthConfig('
                         f"source='topic')), not {type(config).__name__}")
    return config or DEFAULTS


def _as_number(name: str, value: object) -> float:
    """Return a number of any type as a float; ValueError if it is none."""
    number = np.asarray(value)
    if number.ndim or number.dtype.kind not in 'fiu':
        raise ValueError(f'{name} must be a number, not {value!r}')
    return float(number)


def _checked_cover(covered: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return where an image is covered (H, W) bool; ValueError for any other array."""
    covered = np.asarray(covered)
    if covered.shape != shape or covered.dtype != bool:
        raise ValueError(f'covered must be {shape} bool, as the image, not {covered.shape} '
                         f'{covered.dtype}: of a mask of numbers, mask > 0')
    return np.require(covered, requirements='CW')


def _with_height(config: Config, camera_height_m: float | None) -> Config:
    """Return the settings with a measured height, if there is one; ValueError if it cannot be."""
    if camera_height_m is None:
        return config
    camera_height_m = _as_number('camera_height_m', camera_height_m)
    try:
        return replace(config, scale=replace(config.scale, camera_height=camera_height_m))
    except ValueError as error:
        raise ValueError(f'camera_height_m {camera_height_m!r} is not a height: {error}') from None


def _joined(notes: list[str]) -> str:
    return '; '.join(filter(None, notes))


def _sign_note(found: PlaneSegmentation, surroundings: Surroundings, scale: ScaleEstimate) -> str:
    """Return that measured gravity may point up; empty without evidence."""
    gravity = surroundings.gravity
    if gravity.gravity_camera is None or gravity.source in ('image', 'parameter'):
        return ''
    if not (scale.is_metric and scale.has_true_angles):
        return ''
    planes = found.planes
    return sign_question(gravity.gravity_camera, planes.normals, planes.offsets_m, planes.counts,
                         found.labels.size)


def _find_regions(disparity: np.ndarray, intrinsics: CameraIntrinsics, config: Config,
                  floor: Noise, rng: np.random.Generator | None = None,
                  memory: Memory = NO_MEMORY) -> tuple[PixelRegions, Memory]:
    """Segment by ``segmentation.method``; return the memory for the next image too."""
    if config.segmentation.method == 'paper':
        return segment_by_paper(disparity, intrinsics, floor, config, rng), NO_MEMORY
    return segment_next(memory, disparity, floor, config, rng, lens=lens_of(intrinsics))


def _with_facets(planes: PlaneSegmentation, regions: PixelRegions, intrinsics: CameraIntrinsics,
                 config: Config) -> PlaneSegmentation:
    """Return planes, then pieces of curved surfaces: a robot may stand on these too."""
    if not regions.facets.size:
        return planes
    facets = measured_segmentation(regions.of_facets(), intrinsics,
                                   config.segmentation.min_plane_share)
    return replace(planes, planes=planes.planes.concatenated(facets.planes), labels=np.where(
        facets.labels >= 0, facets.labels + np.int32(len(planes.planes)), planes.labels))
