# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The stages after the depth, each as a function; pipeline.py has their order and their state."""

from __future__ import annotations

import numpy as np

from plane_detector.compilation import load_once
from plane_detector.config import Config
from plane_detector.depth.observation import Observation
from plane_detector.directions.finder import ImageDirections, Surroundings
from plane_detector.planes.normal_map import turned_by_normals
from plane_detector.planes.ray_planes import ray_planes
from plane_detector.planes.reorientation import measure_turned
from plane_detector.scale.estimate import ScaleEstimate, apply_scale
from plane_detector.scale.methods import ScaleEvidence, estimate_scale
from plane_detector.scale.temporal_filter import ScaleState, update_scale
from plane_detector.segmentation.baselines import segment_by_paper
from plane_detector.segmentation.cells.grid import lens_of
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.cells.normal_slopes import NormalMap
from plane_detector.segmentation.cells.pixel_regions import PixelRegions
from plane_detector.segmentation.pixels.edge_snapping import GuideImage
from plane_detector.segmentation.segment import metric_noise_floor, segment, unitless_noise_floor
from plane_detector.types import CameraIntrinsics, PlaneSegmentation

# Folders of the loops that every image needs.
LOOPS = ('geometry', 'segmentation', 'planes', 'ground')


def is_turned(seen: Observation) -> bool:
    """Return whether planes are to be rotated by the lines of the image."""
    return seen.config.directions.orient_planes and not seen.is_measured


def noise_floor(seen: Observation, config: Config) -> Noise:
    """Return the lower bound of the noise, in the unit of the disparity."""
    if seen.output != 'relative_disparity' and (
            config.segmentation.disparity_noise or not seen.noise_share):
        return metric_noise_floor(config)
    if config.segmentation.method == 'paper' and seen.output == 'relative_disparity':
        raise ValueError('segmentation.method paper needs depth in metres, but the network gives '
                         'relative_disparity')
    return unitless_noise_floor(seen.disparity, seen.disparity_noise)


def hints(seen: Observation, config: Config) -> dict[str, GuideImage | NormalMap | None]:
    """Return the image that borders snap to, if the network blurs edges, and its normals."""
    if not seen.is_measured:
        load_once(*LOOPS, 'network')
    snaps = config.segmentation.snap_to_picture and seen.edge_blur_px > 0
    guide = GuideImage(seen.rgb, seen.edge_blur_px) if snaps else None
    return {'guide': guide, 'normals': NormalMap.of(seen.prediction, seen.intrinsics)}


def find_regions(disparity: np.ndarray, intrinsics: CameraIntrinsics, config: Config,
                 floor: Noise, rng: np.random.Generator | None = None,
                 **hinted: GuideImage | NormalMap | None) -> PixelRegions:
    """Segment by ``segmentation.method``."""
    load_once(*LOOPS)
    if config.segmentation.method == 'paper':
        return segment_by_paper(disparity, intrinsics, floor, config, rng)
    return segment(disparity, floor, config, rng, lens=lens_of(intrinsics), **hinted)


def next_scale(before: ScaleState | None, seen: Observation, regions: PixelRegions,
               config: Config, around: Surroundings) -> ScaleState:
    """Return the scale of this image, smoothed with those before."""
    evidence = ScaleEvidence(
        seen.disparity, lambda: ray_planes(regions, seen.intrinsics), seen.output,
        seen.is_measured, around.gravity.gravity_camera, around.gravity.tolerance_deg,
        around.level_axes, seen.sensor_depth_m)
    return update_scale(before, estimate_scale(evidence, config.scale), config.scale)


def scaled_depth(seen: Observation, scale: ScaleEstimate, max_depth_m: float) -> np.ndarray:
    """Return the depth (H, W) in the unit of the scale; unscaled metres are returned unchanged."""
    if seen.output == 'metric_depth' and (scale.scale, scale.shift) == (1.0, 0.0):
        return seen.prediction.values
    return apply_scale(seen.disparity, scale, max_depth_m)


def rescaled(regions: PixelRegions, scale: ScaleEstimate, seen: Observation) -> PixelRegions:
    """Return the regions in the unit of the scale, rotated by the network's normals if any."""
    regions = regions.rescaled(scale.scale, scale.shift)
    return (turned_by_normals(regions, seen.prediction, seen.intrinsics)
            if scale.has_true_angles else regions)


def measured_planes(regions: PixelRegions, intrinsics: CameraIntrinsics,
                    config: Config, lines: ImageDirections | None = None) -> PlaneSegmentation:
    """Measure the planes that are large enough, rotated by the lines of the image if given."""
    min_pixels = config.segmentation.min_plane_share * regions.labels.size
    turned = measure_turned(regions, intrinsics, min_pixels, lines)
    return PlaneSegmentation(*turned, regions.noise.mean_sigma,
                             systematic_noise=regions.noise.systematic_sigma)
