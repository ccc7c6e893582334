# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The steps from the depth of a network to planes that measured depth does not need.

1. Borders follow the edges of the image, which networks blur, and normals of the network, if there
   are any, separate planes.
2. The scale and shift to metres are estimated, and smoothed over time.
3. Planes are rotated toward the normals of the network, and to the lines of the image.
4. Unlabelled pixels take the plane of their patch of uniform colour.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from plane_detector.config import Config
from plane_detector.depth.observation import Observation
from plane_detector.directions.finder import Surroundings
from plane_detector.geometry.disparity import UNITLESS
from plane_detector.planes.measurement import measured_segmentation
from plane_detector.planes.normal_map import reoriented_by_normals
from plane_detector.planes.patches import fill_patches
from plane_detector.planes.ray_planes import ray_planes
from plane_detector.planes.reorientation import measure_reoriented
from plane_detector.scale.methods import ScaleEvidence, apply_scale, estimate_scale
from plane_detector.scale.temporal_filter import ScaleState, update_scale
from plane_detector.segmentation.baselines import segment_by_paper
from plane_detector.segmentation.cells.grid import lens_of
from plane_detector.segmentation.cells.model import PixelRegions
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.normal_slopes import NormalMap
from plane_detector.segmentation.pixels.edge_snapping import GuideImage
from plane_detector.segmentation.segment import metric_noise_floor, noise_floor_of_range, segment
from plane_detector.types import PlaneSegmentation, ScaleEstimate


class NetworkSteps:
    """The steps of a stream of a network's depth, with the scale that its images share."""

    loops = ('network',)

    def __init__(self) -> None:
        self._scale: ScaleState | None = None

    def segment(self, observation: Observation, config: Config) -> PixelRegions:
        """Return the pixels of each plane, in the unit of the network."""
        floor = _noise_floor(observation, config)
        if config.segmentation.method == 'paper':
            if observation.prediction.output in UNITLESS:
                raise ValueError('segmentation.method paper needs depth in metres, but the '
                                 f'network gives {observation.prediction.output}')
            return segment_by_paper(observation.disparity, observation.intrinsics, floor, config)
        snaps = config.segmentation.snap_to_picture and observation.edge_blur_px > 0
        return segment(observation.disparity, floor, config,
                       guide=(GuideImage(observation.rgb, observation.edge_blur_px) if snaps
                              else None),
                       normals=NormalMap.of(observation.prediction, observation.intrinsics),
                       lens=lens_of(observation.intrinsics))

    def scale(self, observation: Observation, regions: PixelRegions, surroundings: Surroundings,
              config: Config) -> tuple[ScaleEstimate, str]:
        """Return scale and shift to metres, and a note on a change with this image, if any."""
        evidence = ScaleEvidence(
            observation.disparity, lambda: ray_planes(regions, observation.intrinsics),
            observation.prediction.output, surroundings.gravity.gravity_camera,
            surroundings.gravity.tolerance_deg, surroundings.level_axes, surroundings.open_axes,
            observation.sensor_depth_m)
        self._scale = update_scale(self._scale, estimate_scale(evidence, config.scale),
                                   config.scale)
        return self._scale.estimate, self._scale.event

    def measure(self, observation: Observation, regions: PixelRegions, scale: ScaleEstimate,
                surroundings: Surroundings, config: Config
                ) -> tuple[np.ndarray, PixelRegions, PlaneSegmentation]:
        """Return depth (H, W), regions and planes in metres, or in the unit of the scale."""
        depth_m, is_rescaled = _scaled_depth(observation, scale, config.depth.max_depth)
        intrinsics = observation.intrinsics
        regions = regions.rescaled(scale.scale, scale.shift)
        if observation.prediction.normals_camera is not None and scale.has_true_angles:
            regions = reoriented_by_normals(regions, observation.prediction, intrinsics)
        regions = regions.restricted_to(np.isfinite(depth_m)) if is_rescaled else regions
        share, lines = config.segmentation.min_plane_share, surroundings.lines
        if not (config.directions.orient_planes and scale.has_true_angles) or (
                lines is None or not len(lines.axes)):
            return depth_m, regions, measured_segmentation(regions, intrinsics, share)
        return depth_m, regions, measured_segmentation(
            regions, intrinsics, share, partial(
                measure_reoriented, lines=lines,
                shift_rad=np.radians(np.nan_to_num(scale.angle_sigma_deg))))

    def fill(self, planes: PlaneSegmentation, regions: PixelRegions, depth_m: np.ndarray,
             observation: Observation, shape_labels: np.ndarray) -> np.ndarray:
        """Return the labels (H, W), with unlabelled pixels filled where colours show a surface."""
        if not regions.patches.size:
            return planes.labels
        return fill_patches(planes.labels, regions.patches, planes.planes, depth_m,
                            observation.intrinsics, shape_labels)


def _noise_floor(observation: Observation, config: Config) -> Noise:
    """Return the lower bound of the noise, in the unit of the disparity."""
    if observation.prediction.output not in UNITLESS and (
            config.segmentation.disparity_noise or not observation.noise_share):
        return metric_noise_floor(config, is_measured=False)
    return noise_floor_of_range(observation.range_and_median[0], observation.disparity_noise)


def _scaled_depth(observation: Observation, scale: ScaleEstimate, max_depth_m: float
                  ) -> tuple[np.ndarray, bool]:
    """
    Return the depth (H, W) in the unit of the scale, and whether it has changed.

    Unscaled metres are the same array, valid wherever the disparity was.
    """
    prediction = observation.prediction
    if prediction.output == 'metric_depth' and (scale.scale, scale.shift) == (1.0, 0.0):
        return prediction.values, False
    return apply_scale(observation.disparity, scale, max_depth_m), True
