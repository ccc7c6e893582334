# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Views of simulated relative networks, for the benchmark of the scale."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from plane_detector.config import Config, ScaleConfig
from plane_detector.directions.finder import CameraImage, DirectionFinder, Need, Surroundings
from plane_detector.evaluation.datasets import Frame, frames
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rendering import Scene
from plane_detector.evaluation.scenes.textures import textured
from plane_detector.pipeline import segment_planes
from plane_detector.planes.classification import lowest_level, refine_gravity
from plane_detector.planes.ray_planes import ray_planes
from plane_detector.scale.estimate import ScaleEstimate
from plane_detector.scale.methods import ScaleEvidence, estimate_scale
from plane_detector.segmentation.cells.pixel_regions import PixelRegions
from plane_detector.segmentation.segment import segment, unitless_noise_floor
from plane_detector.types import CameraIntrinsics

SCALE_RANGE, SHIFT_RANGE_PER_M = (0.2, 5.0), (-0.05, 0.4)
NOISE_PER_M = 0.004
# Real images are few, so each is used with this many simulated networks.
DRAWS_PER_IMAGE = 10


@dataclass(frozen=True)
class View:
    """Output of the simulated network for an image, its planes, and the truth."""

    disparity: np.ndarray
    regions: PixelRegions
    true_depth_m: np.ndarray
    intrinsics: CameraIntrinsics
    gravity_camera: np.ndarray
    height_m: float
    true_scale: ScaleConfig
    rng: np.random.Generator
    rgb: np.ndarray

    @cached_property
    def around(self) -> Surroundings:
        """Gravity and horizontal axes from the lines of the image, if any."""
        return DirectionFinder().look(CameraImage(self.rgb, self.intrinsics), None, Config(),
                                      Need.PLANES)

    def estimate(self, config: ScaleConfig, **known: object) -> ScaleEstimate:
        """Return the scale from the planes and other knowledge, see :class:`ScaleEvidence`."""
        return estimate_scale(ScaleEvidence(
            self.disparity, lambda: ray_planes(self.regions, self.intrinsics), **known), config)


def look(scene: Scene | Frame, gravity_camera: np.ndarray, height_m: float,
         rng: np.random.Generator) -> View:
    """Return the output of a network with random scale and shift for an image, and its planes."""
    depth_m = scene.depth_m
    scale = np.exp(rng.uniform(*np.log(SCALE_RANGE)))
    shift = rng.uniform(*SHIFT_RANGE_PER_M)
    noisy_m = with_disparity_noise(depth_m, NOISE_PER_M, rng)
    disparity = (scale * (1.0 / noisy_m + shift)).astype(np.float32)
    truth = ScaleConfig(method='fixed', disparity_scale=1.0 / scale, disparity_shift=-shift)
    regions = segment(disparity, unitless_noise_floor(disparity), Config())
    return View(disparity, regions, depth_m, scene.intrinsics, gravity_camera, height_m, truth,
                rng, scene.rgb)


def rendered_views(make: Callable, seeds: Iterable[int]) -> Iterator[View]:
    """Render scenes."""
    for seed in seeds:
        scene = textured(make, seed)
        yield look(scene, scene.gravity_camera, scene.height_m, np.random.default_rng([seed, 2]))


def real_views(folder: Path, rng: np.random.Generator) -> Iterator[View]:
    """Read a set of real images; gravity and height are from the floor in the sensor's depth."""
    for frame in frames(folder.parent, (folder.name,)):
        planes = segment_planes(frame.depth_m, frame.intrinsics).planes
        gravity_camera = refine_gravity(planes, np.array([0.0, 1.0, 0.0]), 40.0)
        floor = None if gravity_camera is None else lowest_level(planes, gravity_camera)
        if floor is None:
            print(f'{frame.name}: no floor in the sensor\'s depth, left out', file=sys.stderr)
            continue
        for _ in range(DRAWS_PER_IMAGE):
            yield look(frame, -floor.normal, floor.offset_m, rng)
