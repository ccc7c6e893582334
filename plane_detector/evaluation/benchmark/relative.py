# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Angles in relative disparity: true depth with the errors of a network, and raw outputs of networks.

Depth of sensors and of rendered rooms becomes disparity with blurred borders, a smooth error
proportional to the disparity, and a random scale and shift. The shift is estimated from the image
alone. The normals of regions that are one plane are compared with the true ones, and with those at
the true shift, which shows what the shift adds to the error of the network. The planes of the
pipeline, which lines have rotated, are compared in the same way.
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from plane_detector.config import Config, ScaleConfig
from plane_detector.depth.estimator import BLUR_INPUT_PX
from plane_detector.depth.networks import NETWORKS
from plane_detector.depth.observation import DepthFunction
from plane_detector.directions.finder import CameraImage, DirectionFinder
from plane_detector.evaluation.benchmark.report import add_shared, emit, table
from plane_detector.evaluation.datasets import Frame, frames
from plane_detector.evaluation.metrics import angle_deg
from plane_detector.evaluation.peers import plane_array
from plane_detector.evaluation.reference_planes import judge_planes
from plane_detector.evaluation.scenes import rooms
from plane_detector.evaluation.scenes.rendering import Scene
from plane_detector.evaluation.scenes.textures import textured
from plane_detector.pipeline import PlaneDetector
from plane_detector.planes.classification import PlaneClass
from plane_detector.planes.ray_planes import ray_planes
from plane_detector.scale.methods import ScaleEvidence, estimate_scale
from plane_detector.segmentation.cells.model import PixelRegions
from plane_detector.segmentation.segment import segment, unitless_noise_floor
from plane_detector.types import CameraIntrinsics, ScaleEstimate

# Of the simulated networks.
SCALE_RANGE, SHIFT_RANGE_PER_M = (0.2, 5.0), (-0.05, 0.4)
ERROR_SHARES = (0.015, 0.03, 0.05)
# Of the smooth error, of the grain and of the blur of borders; lengths as shares of the width.
CORRELATION_SHARE, GRAIN_SHARE, BLUR_SHARE = 1 / 7, 0.002, 1 / 320
MIN_PLANE_SHARE, PURE = 0.02, 0.85
WRONG_DEG = 10.0
REAL = ('kinect', 'nyu')
DRAWS_PER_IMAGE = 2
STATED_DEG = (0, 2, 4, 6, 8)  # borders of the rows of the calibration
RAW, NOISE_SHARE = 'network_outputs', NETWORKS['depth_anything_v2_small'].noise_share


@dataclass(frozen=True)
class View:
    """Output of a simulated network for an image, its planes, and the truth."""

    disparity: np.ndarray
    regions: PixelRegions
    rgb: np.ndarray
    intrinsics: CameraIntrinsics
    true_depth_m: np.ndarray
    true_scale: ScaleConfig

    def estimate(self, config: ScaleConfig, **known: object) -> ScaleEstimate:
        """Return the scale from the planes and other knowledge, see :class:`ScaleEvidence`."""
        return estimate_scale(ScaleEvidence(
            self.disparity, lambda: ray_planes(self.regions, self.intrinsics), **known), config)

    def by_image(self) -> ScaleEstimate:
        """Return the scale from gravity and horizontal axes of the lines of the image."""
        surroundings = DirectionFinder().find(
            CameraImage(self.rgb, self.intrinsics, None, self.disparity, has_shift=True), None,
            Config(), for_planes=True)
        return self.estimate(
            ScaleConfig(), gravity_camera=surroundings.gravity.gravity_camera,
            down_tolerance_deg=surroundings.gravity.tolerance_deg,
            level_axes=surroundings.level_axes, open_axes=surroundings.open_axes)


@dataclass(frozen=True)
class Angles:
    """Errors of one image, degrees."""

    normal_deg: float  # mean of the normals of regions that are one plane
    at_true_shift_deg: float  # the same at the true scale and shift
    by_shift_deg: float  # root mean square, over pixels, of the rotation by the error of the shift
    stated_deg: float  # stated error of the latter


def network_view(scene: Scene | Frame, error_share: float, rng: np.random.Generator) -> View:
    """Return the output of a relative network with smooth errors for an image, and its planes."""
    disparity = with_network_errors(1.0 / scene.depth_m, error_share, rng)
    scale, shift = np.exp(rng.uniform(*np.log(SCALE_RANGE))), rng.uniform(*SHIFT_RANGE_PER_M)
    relative = (scale * (disparity + shift)).astype(np.float32)
    truth = ScaleConfig(method='fixed', disparity_scale=1.0 / scale, disparity_shift=-shift)
    regions = segment(relative, unitless_noise_floor(relative), Config())
    return View(relative, regions, scene.rgb, scene.intrinsics, scene.depth_m, truth)


def with_network_errors(disparity: np.ndarray, share: float,
                        rng: np.random.Generator) -> np.ndarray:
    """Return disparity (H, W) with blurred borders and errors proportional to it."""
    width = disparity.shape[1]
    known = np.isfinite(disparity)
    total, weight = (cv2.GaussianBlur(image.astype(np.float64), (0, 0), BLUR_SHARE * width)
                     for image in (np.where(known, disparity, 0.0), known))
    smooth, grain = rng.standard_normal((2, *disparity.shape))
    smooth = cv2.GaussianBlur(smooth, (0, 0), CORRELATION_SHARE * width)
    factor = 1.0 + share * smooth / smooth.std() + GRAIN_SHARE * grain
    return np.where(known, factor * total / np.maximum(weight, 1e-6), np.nan)


def angles(view: View, estimate: ScaleEstimate) -> Angles | None:
    """Return the errors of an image; None if no region is one plane."""
    planes = ray_planes(view.regions, view.intrinsics)
    planes = planes.take(np.flatnonzero(
        planes.pixel_share * np.mean(view.regions.labels >= 0) >= MIN_PLANE_SHARE))
    index = np.full(len(view.regions.coefficients) + 1, -1)
    index[planes.labels] = np.arange(len(planes))
    truth = view.true_scale
    at = (planes.scaled(estimate.scale, estimate.shift),
          planes.scaled(truth.disparity_scale, truth.disparity_shift))
    errors_deg, normals = [], []
    for coefficients in at:
        length = np.linalg.norm(coefficients, axis=1)[:, None]
        normals.append(-coefficients / length)
        judged = judge_planes(index[view.regions.labels], np.hstack([normals[-1], 1 / length]),
                              view.true_depth_m, view.intrinsics, np.random.default_rng(0))
        errors_deg.append([one.normal_error_deg for one in judged if one.purity > PURE])
    if not errors_deg[0]:
        return None
    turned_deg = angle_deg(*normals)
    return Angles(*map(float, (
        np.mean(errors_deg[0]), np.mean(errors_deg[1]),
        np.sqrt(np.average(turned_deg**2, weights=planes.pixel_share)),
        estimate.angle_sigma_deg)))


def published_deg(view: View) -> float:
    """Return the mean error of the normals of the pipeline's planes, degrees; NaN if none."""
    disparity, width = view.disparity, view.intrinsics.width
    found = PlaneDetector(Config(), DepthFunction(
        lambda rgb: disparity, 'relative_disparity', NOISE_SHARE, blur_px=2 * BLUR_SHARE * width)
    ).detect(view.rgb, view.intrinsics)
    planes = plane_array(found)
    large = np.flatnonzero(found.planes.counts >= MIN_PLANE_SHARE * found.labels.size)
    index = np.full(len(planes) + 1, -1)
    index[large] = np.arange(len(large))
    judged = judge_planes(index[found.labels], planes[large], view.true_depth_m, view.intrinsics,
                          np.random.default_rng(0))
    errors_deg = [one.normal_error_deg for one in judged if one.purity > PURE]
    return float(np.mean(errors_deg)) if errors_deg else np.nan


def views(name: str, data: Path, seeds: Sequence[int], share: float) -> Iterator[View]:
    """Yield the views of a set of real images, or of rendered rooms."""
    if name not in REAL:
        for seed in seeds:
            yield network_view(textured(rooms.random_room, seed), share,
                               np.random.default_rng([seed, 4]))
        return
    for k, frame in enumerate(frames(data, (name,))):
        for draw in range(DRAWS_PER_IMAGE):
            yield network_view(frame, share, np.random.default_rng([seeds[0], k, draw]))


def report_simulated(data: Path, seeds: Sequence[int]) -> None:
    """Print the table of true depth converted to relative disparity."""
    rows, every = [], []
    for name in (*REAL, 'rooms') if data.is_dir() else ('rooms',):
        for share in ERROR_SHARES:
            asked, found, published = 0, [], []
            for view in views(name, data, seeds, share):
                asked += 1
                estimate = view.by_image()
                if estimate.has_true_angles:
                    found.append(angles(view, estimate))
                    published.append(published_deg(view))
            own = [one for one in found if one]
            every += own
            rows.append([name, f'{share:.1%}', f'{len(found)} of {asked}', *_cells(own),
                         f'{np.nanmean([np.nan, *published]):.1f}'])
    emit('### True depth made relative, with smooth errors and blurred borders', table(
        ('images', 'smooth error', 'answered', 'normals (deg)', 'at the true shift',
         f'images above {WRONG_DEG:.0f} deg', 'by the shift, rms (deg)',
         'of these over stated, rms', 'above two stated', 'planes of the pipeline (deg)'), rows))
    emit('### Uncertainty of angles that is stated, and what the shift turns planes by', table(
        ('stated (deg)', 'images', 'stated, rms', 'actual, rms', 'above two stated'),
        [_calibration(every, *span) for span in itertools.pairwise(STATED_DEG)]))


def _calibration(found: Sequence[Angles], low: float, high: float) -> list[str]:
    turned, stated = np.array([[one.by_shift_deg, one.stated_deg] for one in found
                               if low <= one.stated_deg < high]).reshape(-1, 2).T
    if not len(turned):
        return [f'{low} to {high}', '0', '-', '-', '-']
    return [f'{low} to {high}', str(len(turned)), f'{np.sqrt(np.mean(stated**2)):.1f}',
            f'{np.sqrt(np.mean(turned**2)):.1f}', f'{np.mean(turned > 2 * stated):.0%}']


def _cells(found: Sequence[Angles]) -> list[str]:
    if not found:
        return ['-'] * 6
    normal, known, turned, stated = np.array([list(vars(one).values()) for one in found]).T
    ratio = turned / np.maximum(stated, 0.1)
    return [f'{normal.mean():.1f}', f'{known.mean():.1f}', f'{np.mean(normal > WRONG_DEG):.0%}',
            f'{np.sqrt(np.mean(turned**2)):.1f}', f'{np.sqrt(np.mean(ratio**2)):.2f}',
            f'{np.mean(ratio > 2):.0%}']


def report_raw(data: Path) -> None:
    """Print the results for the raw outputs of networks."""
    rows = []
    for path in sorted((data / RAW).glob('*.json')):
        about = json.loads(path.read_text())
        image = cv2.imread(str(path.with_name(f'{path.stem}_rgb.jpg')))
        rgb = np.ascontiguousarray(image[..., ::-1])
        prediction = np.load(path.with_name(f'{path.stem}_pred.npz'))['prediction']
        values = cv2.resize((prediction * about['factor']).astype(np.float32),
                            rgb.shape[1::-1])
        camera = CameraIntrinsics(*(about[key] for key in (
            'fx', 'fy', 'cx', 'cy', 'width', 'height')))
        detector = PlaneDetector(Config(), DepthFunction(
            lambda rgb, values=values: values, about['output'], NOISE_SHARE,
            blur_px=BLUR_INPUT_PX * min(rgb.shape[:2]) / about['network_short_side']))
        found = detector.detect(rgb, camera)
        kinds = [PlaneClass(kind).name.lower() for kind in found.classes]
        counts = ', '.join(f'{kinds.count(kind)} {kind}' for kind in dict.fromkeys(kinds))
        rows.append([path.stem, about['network'].split(' (')[0],
                     f'{found.gravity.probability:.2f}', found.scale, counts])
    emit('### Raw outputs of networks', table(
        ('picture', 'network', 'probability of the vertical', 'scale', 'classes'), rows))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_shared(parser, '--rooms', '--first-seed', '--data', rooms=10)


def run(options: argparse.Namespace) -> None:
    """Print all tables."""
    report_simulated(options.data, range(options.first_seed, options.first_seed + options.rooms))
    if (options.data / RAW).is_dir():
        report_raw(options.data)
