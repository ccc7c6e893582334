# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Benefits and harm of the temporal filter of depth.

Rendered rooms are seen by a simulated network: true disparity with independent noise in every
image, once metric and once with a random scale and shift in every image. Real images are seen
repeatedly by a real network with independent sensor noise; the agreement of the planes is
measured.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence

import numpy as np
from tqdm import tqdm

from plane_detector.config import Config
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.depth.temporal_filter import FilteredDisparity, filter_disparity
from plane_detector.evaluation.benchmark import options as shared
from plane_detector.evaluation.benchmark.real_images import collect_frames, load_network
from plane_detector.evaluation.benchmark.rooms import HELD_OUT
from plane_detector.evaluation.benchmark.tables import emit, table
from plane_detector.evaluation.datasets import Frame
from plane_detector.evaluation.metrics import score
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.sequences import FRAMES, MOTIONS, View, sequence
from plane_detector.geometry.disparity import noise_reference, to_disparity
from plane_detector.segmentation.segment import segment, unitless_noise_floor

SIGMAS = (0.004, 0.01)
"""Standard deviations of the simulated network's noise, per metre."""
SENSOR_NOISES = (2.0, 5.0)
"""Standard deviations of the noise of real images, grey levels."""
_JUDGED = 4


def predictions(views: Sequence[View], sigma: float, seed: int,
                relative: bool) -> Iterator[tuple[np.ndarray, float, float]]:
    """Yield the output of the simulated network for each image: disparity, scale and shift."""
    rng = np.random.default_rng([seed, 2])
    for view in views:
        disparity = 1.0 / with_disparity_noise(view.scene.depth_m, sigma, rng)
        scale, shift = (rng.uniform(0.5, 2.0), rng.uniform(-0.1, 0.3)) if relative else (1.0, 0.0)
        yield (disparity * np.float32(scale) + np.float32(shift)), scale, shift


def judged(views: Sequence[View], sigma: float, seed: int, relative: bool,
           keeps: Sequence[float]) -> list[list[float]]:
    """
    Return the accuracy of the planes of the last image, for each value of damping.

    Returns
    -------
    list of list of float
        SC, recall, precision, rms error of 1/z where something has moved and elsewhere (1/m).

    """
    told = list(predictions(views, sigma, seed, relative))
    scene, moved = views[-1].scene, views[-1].moved
    seen = np.isfinite(scene.depth_m)
    numbers = []
    for keep in keeps:
        state: FilteredDisparity | None = None
        for view, (disparity, _, _) in zip(views, told, strict=True):
            state = filter_disparity(state, disparity, view.scene.rgb, keep,
                                     same_scale=not relative)
        _, scale, shift = told[-1]
        labels = _labels(state.disparity)
        found = score(scene.labels, scene.planes, labels, _unknown_planes(labels), seen)
        error = (state.disparity - shift) / scale - 1.0 / scene.depth_m
        numbers.append([found.segmentation_covering, found.recall, found.precision,
                        _rms(error[moved & seen]), _rms(error[~moved & seen])])
    return numbers


def _labels(disparity: np.ndarray, disparity_noise: float = 0.0) -> np.ndarray:
    """Return the label of each pixel (H, W) of a disparity of unknown scale and shift."""
    return segment(disparity, unitless_noise_floor(disparity, disparity_noise), Config()).labels


def _unknown_planes(labels: np.ndarray) -> np.ndarray:
    """Return dummy coefficients (N, 4) for scores that depend only on the pixels."""
    return np.zeros((labels.max() + 1, 4))


def _rms(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else np.nan


def report_rooms(seeds: Sequence[int], keeps: Sequence[float]) -> None:
    """Print a table for each kind of network."""
    for relative in (False, True):
        rows = []
        for motion in MOTIONS:
            numbers = np.array([[judged(views, sigma, seed, relative, keeps) for sigma in SIGMAS]
                                for seed in tqdm(seeds, motion.name, leave=False)
                                for views in [sequence(seed, motion)]])
            rows += [[motion.name, f'{sigma:g}', f'{keep:g}', *_cells(numbers[:, s, k])]
                     for s, sigma in enumerate(SIGMAS) for k, keep in enumerate(keeps)]
        emit(f'### {"Relative" if relative else "Metric"} network, rooms {seeds[0]} to '
             f'{seeds[-1]}, image {FRAMES} of each',
             table(('', 'noise (1/m)', 'depth.damping', 'SC', 'worst SC', 'recall', 'precision',
                    'error where it moved (1/m)', 'error elsewhere (1/m)'), rows))


def _cells(numbers: np.ndarray) -> list[str]:
    """Return the means over the rooms."""
    covering, recall, precision, moved, elsewhere = (
        np.mean(column[np.isfinite(column)]) if np.isfinite(column).any() else np.nan
        for column in numbers.T)
    return [f'{covering:.3f}', f'{numbers[:, 0].min():.3f}', f'{recall:.3f}', f'{precision:.3f}',
            f'{moved:.4f}' if np.isfinite(moved) else '-', f'{elsewhere:.4f}']


def report_real(frames: Sequence[Frame], estimate: DepthEstimator, keeps: Sequence[float]) -> None:
    """Print the agreement of the planes of consecutive images, for each set."""
    sets = list(dict.fromkeys(frame.set_name for frame in frames))
    rows = []
    for name in sets:
        of_set = [frame for frame in frames if frame.set_name == name]
        for sigma in SENSOR_NOISES:
            numbers = np.array([agreement(frame.rgb, estimate, sigma, keeps)
                                for frame in tqdm(of_set, name, leave=False)])
            rows.append([name, str(len(of_set)), f'{sigma:g}',
                         *(f'{value:.3f}' for value in numbers.mean(axis=0))])
    emit(f'### {estimate.name} on real images that stand still',
         table(('set', 'images', 'sensor noise (grey levels)',
                *(f'SC of consecutive images, depth.damping {keep:g}' for keep in keeps)), rows),
         f'Each image is seen {FRAMES} times; SC between the planes of one time and of the '
         f'next, mean over the last {_JUDGED}.')


def agreement(rgb: np.ndarray, estimate: DepthEstimator, sigma: float,
              keeps: Sequence[float]) -> list[float]:
    """Return the SC between the planes of consecutive images for each value of damping."""
    rng = np.random.default_rng(0)
    states: list[FilteredDisparity | None] = [None] * len(keeps)
    labels: list[list[np.ndarray]] = [[] for _ in keeps]
    for index in range(FRAMES):
        noisy = np.clip(rgb + rng.normal(0, sigma, rgb.shape), 0, 255).astype(np.uint8)
        disparity = estimate(noisy)
        if estimate.output == 'metric_depth':
            disparity = to_disparity(disparity)
        relative = estimate.output == 'relative_disparity'
        known = estimate.noise_share * noise_reference(disparity)
        for k, keep in enumerate(keeps):
            states[k] = filter_disparity(states[k], disparity, noisy, keep,
                                         same_scale=not relative)
            if index >= FRAMES - _JUDGED:
                labels[k].append(_labels(states[k].disparity, known))
    everywhere = np.ones(rgb.shape[:2], bool)
    return [float(np.mean([
        score(one, _unknown_planes(one), other, _unknown_planes(other),
              everywhere).segmentation_covering
        for one, other in zip(found[:-1], found[1:], strict=True)])) for found in labels]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('--seeds', type=shared.at_least_one, default=10, help='rooms')
    parser.add_argument('--first-seed', type=int, default=HELD_OUT)
    parser.add_argument('--keep', type=_keep, nargs='+', default=[0.0, 0.5, 0.8],
                        help='values of depth.damping, from 0 to below 1')
    shared.add_data(parser)
    shared.add_model(parser)


def _keep(text: str) -> float:
    keep = float(text)
    if not 0 <= keep < 1:
        raise argparse.ArgumentTypeError(f'{text} must be from 0 to below 1')
    return keep


def run(options: argparse.Namespace) -> None:
    """Print the tables."""
    report_rooms(range(options.first_seed, options.first_seed + options.seeds), options.keep)
    estimate, title = load_network(options.model)
    frames = collect_frames(options.data)
    if estimate is None:
        emit(f'{options.model}: {title}')
    elif frames:
        report_real(frames, estimate, options.keep)
