# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""From image and intrinsics to planes: the stages of the pipeline in order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plane_detector.config import Config
from plane_detector.depth.observation import DepthSource, ModelOrFunction, Observation, make_source
from plane_detector.directions.finder import CameraImage, DirectionFinder, Need, Surroundings
from plane_detector.directions.gravity_choice import NO_GRAVITY
from plane_detector.geometry.disparity import to_disparity
from plane_detector.geometry.projection import check_depth
from plane_detector.ground.ground import find_ground
from plane_detector.planes.patches import fill_patches
from plane_detector.scale.temporal_filter import ScaleState
from plane_detector.segmentation.segment import metric_noise_floor
from plane_detector.shapes.detector import ShapeDetector
from plane_detector.stage_timer import StageTimer
from plane_detector.stages import (
    find_regions,
    hints,
    is_turned,
    measured_planes,
    next_scale,
    noise_floor,
    rescaled,
    scaled_depth,
)
from plane_detector.tracking.tracker import PlaneTracker
from plane_detector.types import CameraIntrinsics, Detection, PlaneSegmentation

DEFAULTS = Config()


class PlaneDetector:
    """
    The whole pipeline.

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
    >>> [round(plane.offset_m, 3) for plane in detection.planes], detection.scale_method
    ([2.0], 'metric')

    """

    def __init__(self, config: Config | None = None,
                 depth_model: ModelOrFunction | None = None) -> None:
        self.config = config or DEFAULTS
        self.source: DepthSource = make_source(self.config, depth_model)
        self._scale: ScaleState | None = None
        self._tracker = PlaneTracker()
        self._shapes = ShapeDetector()
        self._directions = DirectionFinder()

    def detect(self, rgb: np.ndarray, intrinsics: CameraIntrinsics,
               depth_m: np.ndarray | None = None, gravity_camera: np.ndarray | None = None,
               covered: np.ndarray | None = None) -> Detection:
        """
        Find the planes of an image.

        Parameters
        ----------
        rgb : (H, W, 3) uint8
            Rectified.
        intrinsics : CameraIntrinsics
            Of that image.
        depth_m : (H, W) floating, optional
            Measured depth of the same image in metres, NaN invalid. With ``config.depth.source``
            ``topic`` it is required and is segmented; with ``model`` it may determine the scale.
        gravity_camera : (3,) floating, optional
            Measured; default: ``config.scale.gravity``.
        covered : (H, W) bool, optional
            False in the black corners that rectification leaves; depth is invalid there.

        Returns
        -------
        Detection

        Raises
        ------
        ValueError
            Depth and intrinsics differ in size, or a required depth image is missing.

        """
        seen = self.observe(rgb, intrinsics, depth_m, covered)
        return self.find_planes(seen, self.look(seen, gravity_camera))

    def observe(self, rgb: np.ndarray, intrinsics: CameraIntrinsics,
                depth_m: np.ndarray | None = None,
                covered: np.ndarray | None = None) -> Observation:
        """
        Run the first stage of :meth:`detect`: the depth of an image.

        Other threads may run the next stages on the images before; each takes them in order.
        """
        stages = StageTimer()
        with stages('depth'):
            seen = self.source.observe(rgb, intrinsics, depth_m, self.config)
            if covered is not None:
                seen = seen.restricted_to(covered)
            check_depth(seen.prediction.values, intrinsics)
        return replace(seen, depth_seconds=stages.seconds['depth'])

    def look(self, seen: Observation, gravity_camera: np.ndarray | None = None,
             may_hold: bool = False) -> Surroundings:
        """Run the second stage: gravity and lines, those found last if allowed."""
        given = None if seen.output == 'relative_disparity' else seen.disparity
        image = CameraImage(seen.rgb, seen.intrinsics, seen.covered, given)
        need = Need.PLANES if is_turned(seen) else Need.GRAVITY
        stages = StageTimer()
        with stages('directions'):
            around = self._directions.look(image, gravity_camera, seen.config, need, may_hold)
        return replace(around, seconds=stages.seconds['directions'])

    def find_planes(self, seen: Observation, around: Surroundings,
                    camera_height_m: float | None = None) -> Detection:
        """Run the third stage of :meth:`detect`: the planes of an image with depth."""
        config, stages = seen.config.with_camera_height(camera_height_m), StageTimer()
        stages.seconds |= {'depth': seen.depth_seconds, 'directions': around.seconds}
        with stages('segmentation'):
            # 1. The pixels of each plane, in the unit of the prediction.
            regions = find_regions(seen.disparity, seen.intrinsics, config,
                                   noise_floor(seen, config), **hints(seen, config))
        with stages('scale'):
            # 2. The scale and shift to metres, smoothed over time.
            self._scale = next_scale(self._scale, seen, regions, config, around)
            scale = self._scale.estimate
        with stages('measurement'):
            # 3. Depth and planes in metres, or in an arbitrary unit if the scale is not known.
            depth_m = scaled_depth(seen, scale, config.depth.max_depth)
            regions = rescaled(regions, scale, seen)
            # Unscaled depth is valid wherever the disparity was.
            valid = (regions if depth_m is seen.prediction.values
                     else regions.restricted_to(np.isfinite(depth_m)))
            planes = measured_planes(
                valid, seen.intrinsics, config,
                around.lines if is_turned(seen) and scale.has_true_angles else None)
        with stages('shapes'):
            # 4. Spheres, cylinders and cones where there is no plane, if requested.
            planes, shapes, shape_labels = self._shapes.detect(
                depth_m, planes, regions, seen.intrinsics, config, scale.is_metric)
        with stages('ground'):
            # 5. Own floor, ramps, obstacles and drops, if angles are true and gravity is known.
            gravity = around.gravity if scale.has_true_angles else NO_GRAVITY
            ground = find_ground(planes, depth_m, seen.intrinsics, gravity, config,
                                 is_metric=scale.is_metric, doubt=seen.doubt)
        with stages('tracking'):
            # 6. Labels that are stable from image to image.
            planes = self._tracker.update(replace(planes, planes=replace(
                planes.planes, classes=np.array(ground.classes, np.uint8))), config.tracking)
        with stages('patches'):
            # 7. Pixels off all planes, if the colours show better where a surface ends.
            labels = fill_patches(planes.labels, regions.patches, planes.planes, depth_m,
                                  seen.intrinsics, shape_labels)
        return Detection(planes.planes, labels, planes.disparity_noise,
                         systematic_noise=planes.systematic_noise, depth_m=depth_m,
                         scale_method=scale.unit_method, scale_note=str(scale),
                         scale_event=self._scale.event, shapes=shapes, shape_labels=shape_labels,
                         gravity_camera=around.gravity.gravity_camera,
                         gravity_source=around.gravity.source, gravity_note=around.gravity.note,
                         gravity_probability=around.gravity.probability,
                         horizontal_axes=around.level_axes, ground_pixels=ground.pixels,
                         drop_note=ground.note, camera_height_m=ground.camera_height_m,
                         tilt_deg=ground.tilt_deg, stage_seconds=stages.seconds)

    def reset(self) -> None:
        """Discard what is kept from earlier images: averages, scale and labels."""
        self.reset_depth()
        self.reset_directions()
        self.reset_planes()

    def reset_depth(self) -> None:
        """Discard the state of :meth:`observe`: the average of the depth."""
        self.source.reset()

    def reset_directions(self) -> None:
        """Discard the state of :meth:`look`: the average of the directions."""
        self._directions.reset()

    def reset_planes(self) -> None:
        """Discard the state of :meth:`find_planes`: scale and labels."""
        self._scale = None
        self._tracker.reset()
        self._shapes.reset()


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
        ``depth_m`` is not a 2-D floating point array, or its size differs from the intrinsics.

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
    config = config or DEFAULTS
    check_depth(depth_m, intrinsics)
    regions = find_regions(to_disparity(depth_m), intrinsics, config,
                           metric_noise_floor(config, disparity_noise), rng)
    return measured_planes(regions, intrinsics, config)
