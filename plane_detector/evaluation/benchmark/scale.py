# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Accuracy of angles and distances with each scale method.

A relative-depth network is simulated: true depth becomes disparity with noise and a random scale
and shift. Its planes are found, scale and shift are estimated from them, and the angles and
distances are compared with those of the true depth in the same pixels. Gravity is that of the
scene with an error, or estimated from the lines of the image; rendered rooms have textures.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from plane_detector.config import Config, ScaleConfig
from plane_detector.directions.finder import CameraImage, DirectionFinder, Surroundings
from plane_detector.evaluation.benchmark.report import add_shared, emit, table
from plane_detector.evaluation.datasets import Frame, frames
from plane_detector.evaluation.labelled_regions import labelled_regions
from plane_detector.evaluation.reference_planes import true_floor
from plane_detector.evaluation.scenes import rooms as scenes
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rendering import Scene
from plane_detector.evaluation.scenes.textures import textured
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
MIN_PLANE_SHARE = 0.02
CLASS_TOLERANCE_DEG = 8.0
# Errors of the values given by a user.
GRAVITY_ERROR_DEG, HEIGHT_ERROR_SHARE = 1.0, 0.02
COARSE_ERROR_DEG, COARSE_TOLERANCE_DEG = 10.0, 20.0
SPARSE_POINTS, WRONG_POINT_SHARE = 200, 0.1
BENT_DEG = 6.0
UP_TO_A_FACTOR = ' (up to one factor)'
UNCORRECTED = 'none (uncorrected)'


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
        return DirectionFinder().find(
            CameraImage(self.rgb, self.intrinsics, None, self.disparity, has_shift=True), None,
            Config(), for_planes=True)

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
        floor = true_floor(frame)
        if floor is None:
            print(f'{frame.name}: no floor in the sensor\'s depth, left out', file=sys.stderr)
            continue
        for _ in range(DRAWS_PER_IMAGE):
            yield look(frame, -floor.normal, floor.offset_m, rng)


@dataclass(frozen=True)
class Errors:
    """Errors of one estimate."""

    angle_deg: np.ndarray  # (n,): of the angle between each wall and the floor
    distance_share: np.ndarray  # (m,): of each plane's distance along the ray through its centre
    bend_deg: float  # largest change of an angle between two planes by scale and shift alone


def measure(view: View, estimate: ScaleEstimate) -> Errors:
    """Compare the planes at the estimated scale with those of the true depth."""
    labels = view.regions.labels
    planes = ray_planes(view.regions, view.intrinsics)
    true = ray_planes(labelled_regions(1.0 / view.true_depth_m, labels), view.intrinsics)
    _, mine, theirs = np.intersect1d(planes.labels, true.labels, return_indices=True)
    mine, theirs = planes.take(mine), true.take(theirs)
    large = theirs.pixel_share * np.mean(labels >= 0) >= MIN_PLANE_SHARE
    got = mine.scaled(estimate.scale, estimate.shift)[large]
    want = theirs.coefficients[large]
    rays = np.column_stack([theirs.centers[large], np.ones(large.sum())])
    ratio = (rays * got).sum(1) / (rays * want).sum(1)
    if not estimate.is_metric:
        ratio /= np.median(ratio)
    true_deg = _angles_deg(want, want)
    bent = _rescaled(want, view.true_scale, estimate)
    bend_deg = np.abs(_angles_deg(bent, bent) - true_deg).max(initial=0.0)
    angle_errors_deg = np.abs(_angles_deg(got, got) - true_deg)
    return Errors(_wall_to_floor(angle_errors_deg, want, view.gravity_camera),
                  np.abs(1.0 / ratio - 1.0), float(bend_deg))


def _rescaled(planes: np.ndarray, truth: ScaleConfig, estimate: ScaleEstimate) -> np.ndarray:
    """Return true planes (N, 3) without noise as they appear with the estimated scale."""
    gain = estimate.scale / truth.disparity_scale
    return gain * planes + [0.0, 0.0, estimate.shift - gain * truth.disparity_shift]


def _wall_to_floor(pair_deg: np.ndarray, planes: np.ndarray, down: np.ndarray) -> np.ndarray:
    down_deg = _angles_deg(planes, down[None])[:, 0]
    walls = np.flatnonzero(np.abs(down_deg - 90.0) <= CLASS_TOLERANCE_DEG)
    level = np.flatnonzero(down_deg <= CLASS_TOLERANCE_DEG)
    if not len(level):
        return np.zeros(0)
    floor = level[np.linalg.norm(planes[level], axis=1).argmin()]
    return pair_deg[floor, walls]


def _angles_deg(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(first, axis=1)[:, None] * np.linalg.norm(second, axis=1)
    return np.degrees(np.arccos((first @ second.T / length).clip(-1, 1)))


def _tilted(direction: np.ndarray, angle_deg: float, rng: np.random.Generator) -> np.ndarray:
    """Return the unit vector rotated by the angle about a random axis."""
    aside = np.cross(direction, rng.standard_normal(3))
    return (np.cos(np.radians(angle_deg)) * direction
            + np.sin(np.radians(angle_deg)) * aside / np.linalg.norm(aside))


def _sparse_depth(view: View) -> ScaleEstimate:
    """Use some points of measured depth, a share of them wrong."""
    index = view.rng.choice(np.flatnonzero(np.isfinite(view.true_depth_m)), SPARSE_POINTS)
    points_m = np.full(view.true_depth_m.shape, np.nan)
    points_m.flat[index] = view.true_depth_m.flat[index]
    wrong = index[:int(WRONG_POINT_SHARE * SPARSE_POINTS)]
    points_m.flat[wrong] = view.rng.uniform(0.5, 8.0, len(wrong))
    return view.estimate(ScaleConfig(method='depth_topic'), sensor_depth_m=points_m)


def by_image_directions(view: View, config: ScaleConfig) -> ScaleEstimate:
    """Use gravity and horizontal axes from the lines of the image."""
    gravity = view.around.gravity
    return view.estimate(config, gravity_camera=gravity.gravity_camera,
                         down_tolerance_deg=gravity.tolerance_deg,
                         level_axes=view.around.level_axes)


def _height(view: View, method: str, gravity_error_deg: float, tolerance_deg: float,
            height_error: float) -> ScaleEstimate:
    sign = view.rng.choice([-1.0, 1.0])
    config = ScaleConfig(method=method, camera_height=view.height_m * (1 + sign * height_error))
    return view.estimate(config, down_tolerance_deg=tolerance_deg,
                         gravity_camera=_tilted(view.gravity_camera, gravity_error_deg, view.rng))


WAYS: dict[str, Callable[[View], ScaleEstimate]] = {
    UNCORRECTED: lambda view: view.estimate(ScaleConfig(method='none')),
    'fixed, the truth: what noise alone leaves': lambda view: view.estimate(view.true_scale),
    f'depth_topic, {SPARSE_POINTS} points, {WRONG_POINT_SHARE:.0%} wrong': _sparse_depth,
    'camera_height, exact': lambda view: _height(view, 'camera_height', 0.0, 0.5, 0.0),
    f'camera_height, {GRAVITY_ERROR_DEG:.0f} deg and {HEIGHT_ERROR_SHARE:.0%} off':
        lambda view: _height(view, 'camera_height', GRAVITY_ERROR_DEG, 2.0, HEIGHT_ERROR_SHARE),
    'camera_height, gravity of the image': lambda view: by_image_directions(
        view, ScaleConfig(method='camera_height', camera_height=view.height_m)),
    'manhattan': lambda view: view.estimate(ScaleConfig(method='manhattan')),
    'manhattan, directions of the image':
        lambda view: by_image_directions(view, ScaleConfig(method='manhattan')),
    f'manhattan + height, gravity {COARSE_ERROR_DEG:.0f} deg off':
        lambda view: _height(view, 'manhattan', COARSE_ERROR_DEG, COARSE_TOLERANCE_DEG, 0.0),
}


def accuracy_table(views: list[View]) -> str:
    """Return the Markdown table of all methods for some views."""
    rows = []
    for name, way in WAYS.items():
        estimates = [(view, way(view)) for view in views]
        answered = [(view, estimate) for view, estimate in estimates
                    if estimate.has_true_angles or name == UNCORRECTED]
        rows.append([name, f'{len(answered)}/{len(views)}', *_accuracy(answered)])
    return table(('scale by', 'answered', 'wall to floor, deg: median', 'worst',
                  'distance, %: median', 'worst'), rows)


def _accuracy(answered: list[tuple[View, ScaleEstimate]]) -> list[str]:
    """Return the last four cells of a row; distances in metres if any estimate has them."""
    metric = any(estimate.is_metric for _, estimate in answered)
    errors = [(measure(view, estimate), estimate) for view, estimate in answered]
    angles = _summary([error.angle_deg for error, _ in errors], 1.0, 2)
    median, worst = _summary([error.distance_share for error, estimate in errors
                              if estimate.is_metric == metric], 100.0, 1)
    return [*angles, median, f'{worst}{"" if metric else UP_TO_A_FACTOR}']


def _summary(values: list[np.ndarray], factor: float, digits: int) -> tuple[str, str]:
    """Return median and largest of all values as text."""
    pooled = factor * np.concatenate([np.zeros(0), *values])
    if not len(pooled):
        return '-', '-'
    return f'{np.median(pooled):.{digits}f}', f'{pooled.max():.{digits}f}'


def refusal_row(name: str, views: Iterable[View],
                way: Callable[[View], ScaleEstimate]) -> list[str]:
    """Return the row of one kind of room: how often a method refuses to estimate the shift."""
    estimates = [(view, way(view)) for view in views]
    accepted = [(view, estimate) for view, estimate in estimates if estimate.has_true_angles]
    bent = sum(measure(view, estimate).bend_deg > BENT_DEG for view, estimate in accepted)
    counts = (len(estimates), len(estimates) - len(accepted), len(accepted) - bent, bent)
    return [name, *map(str, counts)]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_shared(parser, '--rooms', '--first-seed', '--data', rooms=50)


def run(options: argparse.Namespace) -> None:
    """Print all tables."""
    seeds = range(options.first_seed, options.first_seed + options.rooms)
    emit(f'### {options.rooms} rendered rooms',
         accuracy_table(list(rendered_views(scenes.random_room, seeds))))
    for name in ('kinect', 'nyu'):
        if (options.data / name).is_dir():
            views = list(real_views(options.data / name, np.random.default_rng(seeds.start)))
            emit(f'### Real images, {name}: {len(views) // DRAWS_PER_IMAGE} with a floor, '
                 f'each seen by {DRAWS_PER_IMAGE} networks', accuracy_table(views))
        else:
            print(f'{options.data / name} is not there: no table of it', file=sys.stderr)
    for title, way in (('right angles', 'manhattan'),
                       ('the directions of the image', 'manhattan, directions of the image')):
        emit(f'### Refusals: the shift by {title}', table(
            ('room', 'images', 'refused', 'right', f'bent by more than {BENT_DEG:.0f} deg'),
            [refusal_row(make.__name__, rendered_views(make, seeds), WAYS[way])
             for make in (scenes.random_room, scenes.attic, scenes.hexagon_room)]))
