# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Fit of the confidence of planes to rendered rooms, and its check on other rooms."""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np
from sklearn.linear_model import LogisticRegression
from tqdm import tqdm

from plane_detector.evaluation.benchmark.report import HELD_OUT, emit, table
from plane_detector.evaluation.metrics import known_mean, overlap
from plane_detector.evaluation.scenes.living_rooms import living_room
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rooms import Scene, random_room
from plane_detector.pipeline import segment_planes
from plane_detector.planes.measurement import CONFIDENCE_WEIGHTS, MIN_TILT_RAD

SCENES = (random_room, living_room)
FIT_SEEDS, CHECK_SEEDS = range(200, 250), range(HELD_OUT, HELD_OUT + 50)
CONFIDENCE_EDGES = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 1.0)
NOISES = (0.0, 0.002, 0.004, 0.007, 0.01)


def samples(make_scene: Callable[[np.random.Generator], Scene],
            seeds: range) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return features (n, 3) and confidences (n,) of planes, and whether each is correct."""
    features, confidences, matched = [], [], []
    for seed in tqdm(seeds, make_scene.__name__, leave=False):
        rng = np.random.default_rng(seed)
        scene = make_scene(rng)
        for noise in NOISES:
            depth_m = with_disparity_noise(scene.depth_m, noise, rng, rng.uniform(0.2, 0.8),
                                           rng.uniform(6, 20)) if noise else scene.depth_m
            found = segment_planes(depth_m, scene.intrinsics)
            shared = overlap(scene.labels, found.labels, np.isfinite(scene.depth_m))
            matched += list((shared.iou > 0.5).any(axis=0))
            shares = found.planes.counts / found.labels.size
            deviations_rad = np.sqrt(found.planes.normal_variances)
            features.append(np.stack([np.ones(len(shares)), np.log(shares), np.log(
                np.maximum(deviations_rad, MIN_TILT_RAD))], axis=1))
            confidences.append(found.planes.confidences)
    return np.concatenate(features), np.concatenate(confidences), np.array(matched)


def reliability(confidence: np.ndarray, matched: np.ndarray) -> str:
    """Return a Markdown table: for each range of confidence (n,), the share of true planes."""
    rows = []
    for low, high in zip(CONFIDENCE_EDGES[:-1], CONFIDENCE_EDGES[1:], strict=True):
        inside = (confidence > low) & (confidence <= high)
        rows.append([f'{low:g} to {high:g}', str(inside.sum()),
                     *(f'{known_mean(values[inside].astype(float)):.2f}'
                       for values in (confidence, matched))])
    return table(('confidence', 'planes', 'mean confidence', 'share that match'), rows)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare no options."""


def run(options: argparse.Namespace) -> None:
    """Print the fitted weights, and the reliability of those in use on unseen scenes."""
    features, _, matched = (np.concatenate(part) for part in zip(
        *(samples(make_scene, FIT_SEEDS) for make_scene in SCENES), strict=True))
    fit = LogisticRegression(C=10.0, fit_intercept=False).fit(features, matched)
    emit(f'Fitted weights {np.round(fit.coef_[0], 2)}, in use {CONFIDENCE_WEIGHTS}.')
    for make_scene in SCENES:
        _, confidence, matched = samples(make_scene, CHECK_SEEDS)
        emit(f'### {make_scene.__name__}, seeds {CHECK_SEEDS[0]} to {CHECK_SEEDS[-1]}',
             reliability(confidence, matched))
