# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Directions from lines; in real images the reference is the floor in the sensor's depth."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence

import numpy as np

from plane_detector.directions.finder import CameraImage, find_in_image
from plane_detector.directions.vanishing import SceneDirections
from plane_detector.evaluation.benchmark.report import add_shared, emit, table
from plane_detector.evaluation.datasets import Frame, frames
from plane_detector.evaluation.metrics import angle_deg
from plane_detector.evaluation.reference_planes import true_floor
from plane_detector.evaluation.scenes import rooms, textures
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.types import CameraIntrinsics

INDOOR = ('kinect', 'nyu', 'living_room', 'kitchen')
# Held-out frames of the long sequence.
HELD_OUT_FRAME = 5
PARTS = ('gravity', 'rendered')
DEPTH_NOISE_PER_M, WRONG_DEG = (0.0, 0.002, 0.008), 6.0
UPRIGHT_SINE = 0.05
SCENES: dict[str, Callable] = {
    'rooms': rooms.random_room, 'rooms, camera rolled by 10 deg': textures.rolled_room,
    'rooms from straight above': textures.room_from_above,
    'rooms, floor rising by 8 deg': textures.ramp_room, 'attics': rooms.attic,
    'hexagonal rooms': rooms.hexagon_room, 'corridors': rooms.corridor}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('--only', choices=PARTS, help='print this part only')
    add_shared(parser, '--scenes', '--first-seed', '--data', scenes=20)


def run(options: argparse.Namespace) -> None:
    """Print all tables."""
    seeds = range(options.first_seed, options.first_seed + options.scenes)
    if options.only != 'rendered':
        for name in INDOOR:
            report_gravity(name, list(frames(options.data, (name,))))
        report_gravity('living_room, held out',
                       list(frames(options.data, ('living_room',), HELD_OUT_FRAME)))
    if options.only != 'gravity':
        report_rendered(seeds)


def report_gravity(name: str, found: Sequence[Frame]) -> None:
    """Print the error of gravity for each frame."""
    rows, errors = [], []
    for frame in found:
        floor = true_floor(frame)
        seen = _directions(frame.rgb, frame.intrinsics)
        if floor is None or seen.gravity_camera is None:
            rows.append([frame.name, seen.refusal or 'no floor in the sensor\'s depth', '-', '-'])
            continue
        errors.append(angle_deg(seen.gravity_camera, -floor.normal))
        rows.append([frame.name, f'{errors[-1]:.1f}', f'{seen.probability:.2f}',
                     seen.pair_refusal or 'yes'])
    emit(f'### Gravity from lines, {name}: {_summary(errors, len(found))}',
         table(('frame', 'error (deg)', 'probability', 'horizontal axes'), rows))


def _directions(rgb: np.ndarray, intrinsics: CameraIntrinsics,
                disparity: np.ndarray | None = None) -> SceneDirections:
    return find_in_image(CameraImage(rgb, intrinsics, disparity=disparity,
                                     is_measured=disparity is not None)).directions


def _summary(errors: Sequence[float], asked: int) -> str:
    if not errors:
        return f'0 of {asked} answer'
    middle, most, worst = np.quantile(errors, (0.5, 0.9, 1.0))
    return (f'{len(errors)} of {asked} answer, median {middle:.2f} deg, nine of ten within '
            f'{most:.2f}, worst {worst:.2f}')


def report_rendered(seeds: Sequence[int]) -> None:
    """Print the error of gravity and of the horizontal axes in rendered rooms with lines."""
    rows = []
    for name, make in SCENES.items():
        scenes = [textures.textured(make, seed) for seed in seeds]
        seen = [_directions(scene.rgb, scene.intrinsics) for scene in scenes]
        axes = [error for one, scene in zip(seen, scenes, strict=True)
                if one.gravity_camera is not None and len(one.pairs)
                for error in _axis_errors(one.pairs[0], scene)]
        rows.append([name, _summary(_gravity_errors(seen, scenes), len(seeds)),
                     _summary(axes, len(axes)), *(_with_depth(scenes, seeds, sigma)
                                                  for sigma in DEPTH_NOISE_PER_M)])
    answers = sum(_directions(textures.clutter(np.random.default_rng(seed), textures.VGA),
                              textures.VGA).gravity_camera is not None for seed in seeds)
    rows.append(['strokes of all directions', f'{answers} of {len(seeds)} answer', '-',
                 *'-' * len(DEPTH_NOISE_PER_M)])
    emit('### Directions of rendered rooms with lines',
         table(('scene', 'gravity', 'horizontal axes, if a wall or slope is within 10 deg',
                *(f'gravity, depth with noise {sigma:g}' for sigma in DEPTH_NOISE_PER_M)), rows))


def _with_depth(scenes: Sequence[rooms.Scene], seeds: Sequence[int], sigma: float) -> str:
    """Return a summary of the errors of gravity from lines and depth."""
    seen = []
    for scene, seed in zip(scenes, seeds, strict=True):
        depth_m = with_disparity_noise(scene.depth_m, sigma, np.random.default_rng([seed, 2]))
        seen.append(_directions(scene.rgb, scene.intrinsics, (1 / depth_m).astype(np.float32)))
    errors = _gravity_errors(seen, scenes)
    return f'{_summary(errors, len(seeds))}, {np.sum(np.array(errors) > WRONG_DEG)} wrong'


def _gravity_errors(seen: Sequence[SceneDirections], scenes: Sequence[rooms.Scene]) -> list[float]:
    """Return the errors, in degrees, of the available directions of gravity."""
    return [angle_deg(one.gravity_camera, scene.gravity_camera)
            for one, scene in zip(seen, scenes, strict=True) if one.gravity_camera is not None]


def _axis_errors(axes: np.ndarray, scene: rooms.Scene) -> list[float]:
    """Return the angle between a horizontal axis and the closest wall or inclined floor."""
    normals, down = scene.planes[:, :3], scene.gravity_camera
    level = normals - np.outer(normals @ down, down)
    length = np.linalg.norm(level, axis=1)
    is_seen = length > UPRIGHT_SINE
    if not is_seen.any():
        return []
    level = level[is_seen] / length[is_seen, None]
    nearest = np.degrees(np.arccos(np.clip(np.abs(axes @ level.T).max(), 0, 1)))
    return [float(nearest)] if nearest < 10 else []
