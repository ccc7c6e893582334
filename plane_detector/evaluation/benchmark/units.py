# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
One scene in the units that networks use: metres, disparity, relative disparity, other sizes.

The noise of a network is stated as a share of the disparities of the image, so that the planes of
a scene do not depend on its unit. The scenes are saved depth of strong networks, dense depth from
the lidar of KITTI with the noise of a network, and rendered rooms at their size and ten times as
large.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.interpolate import LinearNDInterpolator

from plane_detector.config import Config, DepthConfig, DirectionsConfig
from plane_detector.depth.depth_function import DepthFunction
from plane_detector.depth.networks import FASTDEPTH_NOISE_SHARE
from plane_detector.drawing import overlay
from plane_detector.evaluation.benchmark import options as shared
from plane_detector.evaluation.benchmark.rooms import HELD_OUT
from plane_detector.evaluation.benchmark.tables import emit, grey_of, table
from plane_detector.evaluation.datasets import Frame, frames
from plane_detector.evaluation.scenes import rooms
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.geometry.disparity import noise_reference, to_depth, to_disparity
from plane_detector.pipeline import PlaneDetector
from plane_detector.types import CameraIntrinsics

STRONG = 'strong_networks'
# Scale and shift of the relative disparity, the shift as a share of the median disparity.
RELATIVE_SCALE, RELATIVE_SHIFT = 3.7, 0.1
# Assumed for the one camera that is not known.
STATED_FIELD_OF_VIEW_DEG = 40.0
ROOM_SIZES = (1, 10)
# Networks have smooth errors: correlation length as a share of the image width.
CORRELATION_SHARE = 0.02
NO_DIRECTIONS = Config(depth=DepthConfig(max_depth=1e4),
                       directions=DirectionsConfig(gravity=False, orient_planes=False))


@dataclass(frozen=True)
class Found:
    """Labels (H, W) int, -1 none, and the number of planes."""

    labels: np.ndarray
    count: int


def strong_networks(folder: Path) -> Iterator[Frame]:
    """Yield saved depth of strong networks, in a folder as in evaluation/datasets.py."""
    for name, camera in json.loads((folder / 'cameras.json').read_text()).items():
        depth_m = np.load(folder / f'{name}_pred.npy').astype(np.float32)
        size = depth_m.shape[::-1]
        lens = CameraIntrinsics.from_field_of_view(*size, STATED_FIELD_OF_VIEW_DEG)
        if camera['fx']:
            lens = CameraIntrinsics(*(camera[key] for key in (
                'fx', 'fy', 'cx', 'cy', 'width', 'height')))
        bgr = cv2.imread(str(next(folder.glob(f'{name}_rgb.*'))))
        rgb = cv2.resize(bgr, size, interpolation=cv2.INTER_AREA)[..., ::-1]
        yield Frame(STRONG, name, np.ascontiguousarray(rgb), depth_m, lens)


def streets(data: Path, share: float) -> Iterator[Frame]:
    """Yield the frames of KITTI, with dense depth from lidar and the noise of a network."""
    for k, frame in enumerate(frames(data, ('kitti',))):
        seen = np.isfinite(frame.depth_m)
        row, column = np.nonzero(seen)
        grid = np.meshgrid(*(np.arange(side) for side in seen.shape[::-1]))
        points = np.column_stack([column, row])
        dense = LinearNDInterpolator(points, 1 / frame.depth_m[seen])(*grid)
        depth_m = to_depth(cv2.medianBlur(np.nan_to_num(dense).astype(np.float32), 5))
        sigma = share * noise_reference(to_disparity(depth_m))
        noisy_m = with_disparity_noise(depth_m, sigma, np.random.default_rng(k), 1.0,
                                       CORRELATION_SHARE * seen.shape[1])
        yield replace(frame, depth_m=noisy_m)


def rooms_of_sizes(seeds: range, share: float) -> Iterator[Frame]:
    """Yield rendered rooms at their own size and larger, with the noise of a network."""
    for seed in seeds:
        scene = rooms.random_room(np.random.default_rng(seed))
        sigma = share * noise_reference(to_disparity(scene.depth_m))
        noisy_m = with_disparity_noise(scene.depth_m, sigma, np.random.default_rng(seed), 0.9)
        for size in ROOM_SIZES:
            yield Frame('rooms', f'room {seed}, size {size}', scene.rgb,
                        np.float32(size) * noisy_m, scene.intrinsics)


def in_all_units(frame: Frame, share: float, config: Config) -> dict[str, Found]:
    """Return the planes of a scene from the output of each kind of network."""
    disparity = to_disparity(frame.depth_m)
    shifted = RELATIVE_SCALE * (disparity + RELATIVE_SHIFT * np.nanmedian(disparity))
    kinds = {'metric_depth': frame.depth_m, 'disparity': disparity, 'relative_disparity': shifted}
    found = {}
    for kind, values in kinds.items():
        model = DepthFunction(lambda rgb, values=values: values.astype(np.float32), kind, share)
        planes = PlaneDetector(config, model).detect(frame.rgb, frame.intrinsics)
        found[kind] = Found(planes.labels, len(planes.planes))
    return found


def agreement(labels: np.ndarray, others: np.ndarray) -> float:
    """Return the share of labelled pixels on the corresponding plane of ``others``."""
    same = [np.bincount(others[(labels == k) & (others >= 0)], minlength=1).max()
            for k in range(labels.max(initial=-1) + 1)]
    return sum(same) / max(np.count_nonzero(labels >= 0), 1)


def row(frame: Frame, share: float, config: Config) -> tuple[list[str], Found]:
    """Return the cells of a scene, and its planes from metres."""
    found = in_all_units(frame, share, config)
    metric, disparity, relative = found.values()
    valid = np.isfinite(frame.depth_m)
    cells = [frame.name, f'{share:g}', *(str(one.count) for one in found.values()),
             *(f'{agreement(metric.labels, one.labels):.3f}' for one in (disparity, relative)),
             f'{np.mean(metric.labels[valid] >= 0):.2f}']
    return cells, metric


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('--shares', type=float, nargs='+', default=[0.006, FASTDEPTH_NOISE_SHARE],
                        help='noise of the network; the default ends with that of fastdepth')
    parser.add_argument('--rooms', type=shared.at_least_one, default=5)
    parser.add_argument('--first-seed', type=int, default=HELD_OUT)
    shared.add_data(parser)
    shared.add_output(parser)


def run(options: argparse.Namespace) -> None:
    """Print the table, and write an image of the planes from metres for each scene."""
    options.output.mkdir(parents=True, exist_ok=True)
    rows = []
    for share in options.shares:
        scenes = list(rooms_of_sizes(range(options.first_seed, options.first_seed + options.rooms),
                                     share))
        if (options.data / STRONG).is_dir():
            scenes += strong_networks(options.data / STRONG)
        if (options.data / 'kitti').is_dir():
            scenes += streets(options.data, share)
        for frame in scenes:
            cells, metric = row(frame, share, NO_DIRECTIONS)
            rows.append(cells)
            image = overlay(grey_of(frame.rgb), metric.labels + 1)
            cv2.imwrite(str(options.output / f'{frame.name} {share:g}.png'), image[..., ::-1])
    header = ('scene', 'noise share', 'planes: metres', 'disparity', 'relative', 'same segments: '
              'disparity', 'relative', 'labelled')
    emit('### One scene in the units of networks', table(header, rows),
         'Same segments: share of the pixels labelled from metres that lie on the corresponding '
         'plane. Planes are not turned by lines, which joins pieces where angles are true only.',
         f'The images are in {options.output}.')
