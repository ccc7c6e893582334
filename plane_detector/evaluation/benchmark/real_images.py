# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tables and contact sheets on real images, evaluated with the sensor's depth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np
from tqdm import tqdm

from plane_detector.config import Config, DepthConfig
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.depth.model_zoo import NetworkUnavailableError
from plane_detector.drawing import overlay
from plane_detector.evaluation.benchmark.fragmentation import (
    LARGE_PLANE_SHARE,
    NEAR_DEVIATIONS,
    held_and_holdable,
)
from plane_detector.evaluation.benchmark.rooms import SIGMAS
from plane_detector.evaluation.benchmark.tables import emit, table, write_sheet
from plane_detector.evaluation.datasets import Frame, frames, library_frames
from plane_detector.evaluation.metrics import Coverage, coverage, score
from plane_detector.evaluation.peers import plane_array
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.pipeline import PlaneDetector, segment_planes
from plane_detector.tools.demo.sensor_comparison import JudgedPlane, judge_planes
from plane_detector.types import Detection, PlaneSegmentation

RENDERED = ('living_room',)
"""Sets with clean rendered depth."""
_PANEL_WIDTH_PX = 480
# Columns of the table of frames, with the format of their numbers.
_COLUMNS = {'planes by sensor': '.0f', 'pixels on them': '.2f', 'planes by network': '.0f',
            'purity': '.2f', 'worst purity': '.2f', 'normal error (deg)': '.1f',
            'offset error (cm)': '.0f', 'large planes': '.0f', 'coverage': '.2f',
            'pieces': '.1f'}


@dataclass(frozen=True)
class Comparison:
    """A frame with its planes from the sensor and from the network; None without a network."""

    frame: Frame
    sensor: PlaneSegmentation
    network: Detection | None
    judged: Sequence[JudgedPlane]
    coverage: Coverage | None


def collect_frames(data: Path) -> list[Frame]:
    """Return the frames of the data folder and of the libraries; prints which are missing."""
    found: list[Frame] = []
    for source in (lambda: frames(data), library_frames):
        try:
            found += source()
        except (FileNotFoundError, ImportError) as error:
            emit(f'Not looked at: {error}.')
    return found


def report_real(found: Sequence[Frame], model: str, output: Path) -> None:
    """Print the table of all frames and write a contact sheet of each set."""
    estimate, title = load_network(model)
    emit(f'### Real images: planes of the sensor and of the network ({title})')
    compared = [compare(frame, estimate) for frame in tqdm(found, 'real frames', leave=False)]
    emit(table(('frame', *_COLUMNS), _rows(compared)),
         'Purity and errors are means over the predicted planes of a frame, weighed by their '
         'pixels: purity is the share within max(3 cm, 1.5 % of z) of the best plane through '
         'the sensor\'s points there. Coverage: of the sensor\'s large planes, those over 2 % of '
         'the image, the share of pixels that a predicted plane with IoU > 0.5 covers; pieces: '
         'predicted planes that hold over a tenth of each of them.')
    emit(*(f'Contact sheet: `{path}`' for path in write_sheets(compared, output)))
    if estimate is not None:
        _report_pieces(compared)


def _report_pieces(compared: Sequence[Comparison]) -> None:
    """Print the share of large planes in one predicted plane, and the largest possible share."""
    rows = []
    for name, group in groupby(compared, lambda one: one.frame.set_name):
        shares = np.array([pair for one in group if one.network for pair in held_and_holdable(
            one.sensor.labels, one.network.labels, one.network.depth_m, one.frame.intrinsics,
            one.network.disparity_noise, np.random.default_rng(0))]).reshape(-1, 2)
        if len(shares):
            rows.append([name, str(len(shares)), *(
                f'{value:.2f}' for value in (*shares.mean(0), *shares.min(0)))])
    emit('### Real images: the floor and the large walls in the depth of the network',
         table(('set', 'planes', 'one holds', 'one could hold', 'worst holds',
                'worst could hold'), rows),
         f'Planes of the sensor over {LARGE_PLANE_SHARE:.0%} of the image: the share of their '
         'pixels that the predicted plane with most of them holds, and the share within '
         f'{NEAR_DEVIATIONS:g} deviations of the noise of the frame of the best plane '
         'through the network\'s depth there, found with the sensor\'s labels at hand.')


def load_network(model: str) -> tuple[DepthEstimator | None, str]:
    """
    Return a network and its name; None and the reason if it is not available.

    Raises
    ------
    ValueError, FileNotFoundError
        It is not a network, or its name is unknown.

    """
    try:
        estimate = DepthEstimator(DepthConfig(model=model))
    except NetworkUnavailableError as error:
        return None, f'absent: {error}'
    return estimate, f'{estimate.name}, {estimate.output}'


def compare(frame: Frame, estimate: Callable[[np.ndarray], np.ndarray] | None) -> Comparison:
    """Segment a frame in both kinds of depth and evaluate the network's planes."""
    sensor = segment_planes(frame.depth_m, frame.intrinsics)
    if estimate is None:
        return Comparison(frame, sensor, None, (), None)
    network = PlaneDetector(Config(), estimate).detect(frame.rgb, frame.intrinsics)
    judged = judge_planes(network.labels, plane_array(network), frame.depth_m, frame.intrinsics,
                          np.random.default_rng(0))
    covered = coverage(sensor.labels, network.labels, np.isfinite(frame.depth_m))
    return Comparison(frame, sensor, network, judged, covered)


def _numbers(one: Comparison) -> np.ndarray:
    """Return the numbers of a frame for the columns after the first; NaN where unknown."""
    on_plane = (one.sensor.labels >= 0)[np.isfinite(one.frame.depth_m)].mean()
    numbers = [len(one.sensor.planes), on_plane]
    if one.network is None or one.coverage is None:
        return np.array([*numbers, *[np.nan] * (len(_COLUMNS) - len(numbers))])
    judged = np.array([(plane.purity, plane.normal_error_deg, 100 * plane.offset_error_m)
                       for plane in one.judged]).reshape(-1, 3)
    weight = [plane.pixels for plane in one.judged]
    purity, angle_deg, offset_cm = (
        np.average(judged, axis=0, weights=weight) if len(judged) else np.full(3, np.nan))
    return np.array([*numbers, len(one.network.planes), purity, judged[:, 0].min(initial=1.0),
                     angle_deg, offset_cm, one.coverage.planes, one.coverage.share,
                     one.coverage.pieces])


def _rows(compared: Sequence[Comparison]) -> list[list[str]]:
    """Return a row for each frame, and after each set with several frames their mean."""
    rows = []
    for name, group in groupby(compared, lambda one: one.frame.set_name):
        members = list(group)
        numbers = np.array([_numbers(one) for one in members])
        rows += [[f'{name}/{one.frame.name}', *_cells(line)]
                 for one, line in zip(members, numbers, strict=True)]
        if len(members) > 1:
            rows.append([f'**{name}, mean**', *_cells(_known_mean(numbers))])
    return rows


def _cells(numbers: np.ndarray) -> list[str]:
    return [f'{value:{form}}' if np.isfinite(value) else '-'
            for value, form in zip(numbers, _COLUMNS.values(), strict=True)]


def _known_mean(numbers: np.ndarray) -> np.ndarray:
    """Return the mean of the known values of each column; NaN if there are none."""
    known = np.isfinite(numbers)
    return np.where(known.any(0), np.where(known, numbers, 0).sum(0) / np.maximum(known.sum(0), 1),
                    np.nan)


def write_sheets(compared: Sequence[Comparison], output: Path) -> list[Path]:
    """Write a contact sheet for each set, with a row for each frame; return the paths."""
    paths = []
    for name, group in groupby(compared, lambda one: one.frame.set_name):
        panels = [panel for one in group for panel in _panels(one)]
        paths.append(write_sheet(output / f'{name}.png', panels, 3, _PANEL_WIDTH_PX))
    return paths


def _panels(one: Comparison) -> list[tuple[str, np.ndarray]]:
    """Return image, planes from the sensor and planes from the network, with titles."""
    name, rgb = f'{one.frame.set_name}/{one.frame.name}', one.frame.rgb
    panels = [(name, rgb), (f'sensor: {len(one.sensor.planes)} planes',
                            overlay(rgb, one.sensor.labels + 1))]
    if one.network is None:
        panels.append(('network: absent', np.zeros_like(rgb)))
    else:
        panels.append((f'network: {len(one.network.planes)} planes',
                       overlay(rgb, one.network.labels + 1)))
    return panels


def report_consistency(found: Sequence[Frame]) -> None:
    """Print the change of the result on clean rendered depth under noise."""
    clean = [frame for frame in found if frame.set_name in RENDERED]
    if not clean:
        return
    emit('### Rendered living room: consistency under noise')
    rows = []
    for sigma in SIGMAS[1:]:
        scores = [_consistency(frame, sigma, k) for k, frame in enumerate(clean)]
        columns = [[getattr(one, name) for one in scores] for name in (
            'segmentation_covering', 'recall', 'precision', 'normal_error_deg')]
        rows.append([f'{sigma:g}', str(len(clean)), f'{np.mean(columns[0]):.3f}',
                     f'{np.min(columns[0]):.2f}',
                     *(f'{np.nanmean(values):.2f}' for values in columns[1:])])
    emit(table(('noise (1/m)', 'frames', 'SC', 'worst SC', 'recall', 'precision',
                'normal change (deg)'), rows),
         'Here the planes found in noisy depth are compared with those that the same method finds '
         'in the clean depth of the same frames. This says how stable the result '
         'is, not how right.')


def _consistency(frame: Frame, sigma: float, seed: int):
    clean = segment_planes(frame.depth_m, frame.intrinsics)
    noisy_m = with_disparity_noise(frame.depth_m, sigma, np.random.default_rng(seed))
    noisy = segment_planes(noisy_m, frame.intrinsics)
    return score(clean.labels, plane_array(clean), noisy.labels, plane_array(noisy),
                 np.isfinite(frame.depth_m))
