# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Directions from lines, and the orientation of planes in a network's depth with and without them.

The reference for gravity in real images is the floor in the sensor's depth, for planes the best
plane through the sensor's points in their pixels.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from plane_detector.config import Config, DepthConfig, DirectionsConfig, SegmentationConfig
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.depth.networks import NetworkUnavailableError
from plane_detector.depth.observation import DepthFunction
from plane_detector.directions.finder import CameraImage, find_in_image
from plane_detector.directions.posterior import CLOSE_DEG
from plane_detector.directions.vanishing import SceneDirections
from plane_detector.evaluation.benchmark.report import (
    add_shared,
    emit,
    new_figure,
    save_figure,
    table,
)
from plane_detector.evaluation.datasets import Frame, frames
from plane_detector.evaluation.metrics import (
    PURE,
    angle_deg,
    overlap,
    pure_errors,
    segmentation_covering,
)
from plane_detector.evaluation.peers import plane_array
from plane_detector.evaluation.reference_planes import JudgedPlane, judge_planes, true_floor
from plane_detector.evaluation.scenes import misleading, rooms, textures
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.pipeline import PlaneDetector
from plane_detector.types import CameraIntrinsics

INDOOR = ('kinect', 'nyu', 'living_room', 'kitchen')
# Held-out frames of the long sequence.
HELD_OUT_FRAME = 5
PARTS = ('gravity', 'calibration', 'rendered', 'planes', 'misleading')
# Of the probability that is said.
BINS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.01)
PARTS_PER_FRAME = 6
DEPTH_NOISE_PER_M, WRONG_DEG = (0.0, 0.002, 0.008), 6.0
MISLEADING_NOISE_PER_M, BLUR_PX = (0.0, 0.002, 0.008), 3.0
PLAIN = 'doors, planks and tiles'
UPRIGHT_SINE = 0.05
SCENES: dict[str, Callable] = {
    'rooms': rooms.random_room, 'rooms, camera rolled by 10 deg': textures.rolled_room,
    'rooms from straight above': textures.room_from_above,
    'rooms, floor rising by 8 deg': textures.ramp_room, 'attics': rooms.attic,
    'hexagonal rooms': rooms.hexagon_room}
WAYS = {'without': DirectionsConfig(gravity=False, orient_planes=False),
        'with': DirectionsConfig()}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('--only', choices=PARTS, action='append',
                        help='print this part only; may be given again')
    parser.add_argument('--plots', type=Path, metavar='FOLDER',
                        help='write calibration.svg there, with the part calibration')
    add_shared(parser, '--scenes', '--first-seed', '--data', '--model', scenes=20)


def run(options: argparse.Namespace) -> None:
    """Print all tables."""
    parts = options.only or PARTS
    seeds = range(options.first_seed, options.first_seed + options.scenes)
    if options.data.is_dir():
        found = {name: list(frames(options.data, (name,))) for name in INDOOR}
        found['living_room, held out'] = list(frames(options.data, ('living_room',),
                                                     HELD_OUT_FRAME))
        for name, own in found.items():
            if 'gravity' in parts:
                report_gravity(name, own)
            if 'planes' in parts:
                report_planes(name, own, options.model)
    else:
        emit(f'Real images: {options.data} is not there.')
    if 'calibration' in parts:
        report_calibration(options.data, seeds, options.plots)
    if 'misleading' in parts:
        report_misleading(seeds)
    if 'rendered' in parts:
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
    return find_in_image(CameraImage(rgb, intrinsics, disparity=disparity)).directions


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
        axes = [error for one, scene in zip(seen, scenes, strict=True) if len(one.pairs)
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
    """Return the errors, degrees, of the directions of gravity that are given."""
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


def report_calibration(data: Path, seeds: Sequence[int], folder: Path | None) -> None:
    """Print how many verticals are right, by the probability that is said, and draw it."""
    rng, said = np.random.default_rng(seeds[0]), {}
    whole = (slice(None),) * 2
    for frame in frames(data, (*INDOOR, 'real_unlabelled')) if data.is_dir() else ():
        floor = true_floor(frame)
        parts = [whole, *(_part(frame.depth_m.shape, rng) for _ in range(PARTS_PER_FRAME))]
        if floor is not None:
            said.setdefault('real frames and parts of them', []).extend(
                _said(frame.rgb, frame.intrinsics, part, -floor.normal) for part in parts)
    for make, seed in itertools.product(SCENES.values(), seeds):
        scene = textures.textured(make, seed)
        said.setdefault('rendered scenes', []).append(
            _said(scene.rgb, scene.intrinsics, whole, scene.gravity_camera))
    rows = []
    for name, pairs in said.items():
        probability, error_deg = np.array(pairs).T
        is_in = np.digitize(probability, BINS) - 1
        rows.append([name, *(f'{np.mean(error_deg[is_in == k] <= CLOSE_DEG):.2f} of '
                             f'{np.sum(is_in == k)}' if (is_in == k).any() else '-'
                             for k in range(len(BINS) - 1))])
    emit(f'### Verticals within {CLOSE_DEG:.0f} degrees, by the probability that is said',
         table(('images', *(f'{low:g} to {high:g}' for low, high in itertools.pairwise(BINS))),
               rows))
    if folder:
        emit(f'Figure: `{write_calibration(said, folder)}`')


def write_calibration(said: Mapping[str, Sequence[tuple[float, float]]], folder: Path) -> Path:
    """Draw the share of right verticals over the probability said; ImportError as accuracy."""
    figure = new_figure((4.6, 4.2))
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color='grey', linestyle=':', label='as said')
    for marker, (name, pairs) in zip('os', said.items(), strict=False):
        probability, error_deg = np.array(pairs).T
        is_in, is_right = np.digitize(probability, BINS) - 1, error_deg <= CLOSE_DEG
        bins = np.unique(is_in)
        right = np.array([is_right[is_in == k].mean() for k in bins])
        count = np.array([np.sum(is_in == k) for k in bins])
        # One standard deviation of a share, with one right and one wrong answer added to it.
        share = (right * count + 1) / (count + 2)
        axes.errorbar([probability[is_in == k].mean() for k in bins], right,
                      np.sqrt(share * (1 - share) / (count + 2)), marker=marker, capsize=3,
                      label=f'{name}, {len(pairs)}')
    axes.set(xlabel='probability that is said', xlim=(0, 1.02), ylim=(0, 1.05),
             ylabel=f'share within {CLOSE_DEG:.0f} degrees of the vertical')
    axes.grid(alpha=0.3)
    axes.legend(loc='upper left')
    return save_figure(figure, folder / 'calibration.svg')


def _part(shape: tuple[int, int], rng: np.random.Generator) -> tuple[slice, slice]:
    """Return rows and columns of a part of half to all of the width and height."""
    size = rng.uniform(0.5, 1.0) * np.array(shape)
    top, left = rng.uniform(0, np.array(shape) - size).astype(int)
    return slice(top, top + int(size[0])), slice(left, left + int(size[1]))


def _said(rgb: np.ndarray, intrinsics: CameraIntrinsics, part: tuple[slice, slice],
          truth: np.ndarray) -> tuple[float, float]:
    """Return the probability of the most likely vertical of a part, and its error in degrees."""
    rgb = np.ascontiguousarray(rgb[part])
    own = replace(intrinsics, cx=intrinsics.cx - (part[1].start or 0),
                  cy=intrinsics.cy - (part[0].start or 0), width=rgb.shape[1],
                  height=rgb.shape[0])
    found = _directions(rgb, own)
    return found.probability, angle_deg(found.modes.downs[0], truth)


def report_planes(name: str, found: Sequence[Frame], model: str) -> None:
    """Print the errors of the network's planes with and without directions, for each frame."""
    try:
        estimate = load_network(model)
    except NetworkUnavailableError as error:
        emit(f'Planes of a network: absent: {error}')
        return
    judged = {way: [_judged(frame, PlaneDetector(Config(directions=config), estimate))
                    for frame in found] for way, config in WAYS.items()}
    rows = [[frame.name, *(cell for way in WAYS for cell in _cells(judged[way][k]))]
            for k, frame in enumerate(found)]
    rows.append(['**all**', *(cell for way in WAYS
                              for cell in _cells(itertools.chain(*judged[way])))])
    columns = ('all (deg)', 'pure (deg)', 'purity', 'offset (cm)')
    emit(f'### Planes of {model}, {name}',
         table(('frame', *(f'{way}: {column}' for way in WAYS for column in columns)), rows),
         f'Means over planes weighted by pixels; pure: more than {PURE:.0%} of the pixels on one '
         'plane of the sensor.')


def load_network(model: str) -> DepthEstimator:
    """Return a network; raises NetworkUnavailableError."""
    return DepthEstimator(DepthConfig(model=model))


def _judged(frame: Frame, detector: PlaneDetector) -> list[JudgedPlane]:
    found = detector.detect(frame.rgb, frame.intrinsics)
    return judge_planes(found.labels, plane_array(found), frame.depth_m, frame.intrinsics,
                        np.random.default_rng(0))


def _cells(judged: Iterable[JudgedPlane]) -> list[str]:
    judged = list(judged)
    pure = [plane for plane in judged if plane.purity > PURE]
    return [f'{_mean(judged, "normal_error_deg"):.1f}', f'{_mean(pure, "normal_error_deg"):.1f}',
            f'{_mean(judged, "purity"):.2f}', f'{100 * _mean(judged, "offset_error_m"):.0f}']


def _mean(judged: Sequence[JudgedPlane], name: str) -> float:
    if not judged:
        return float('nan')
    return float(np.average([getattr(plane, name) for plane in judged],
                            weights=[plane.pixels for plane in judged]))


def report_misleading(seeds: Sequence[int]) -> None:
    """Print what pictures that contradict good depth do to it."""
    rows = []
    for kind, sigma in itertools.product((PLAIN, *misleading.KINDS), MISLEADING_NOISE_PER_M):
        row = [kind, f'{sigma:g}']
        for way in WAYS:
            covering, errors_deg = zip(*(_misled(kind, sigma, seed, way) for seed in seeds),
                                       strict=True)
            all_deg = np.concatenate(errors_deg)
            row += [f'{np.mean(covering):.4f}', f'{all_deg.mean():.3f}', f'{all_deg.max():.2f}']
        rows.append(row)
    columns = ('SC', 'mean angle (deg)', 'worst (deg)')
    emit('### Good depth with misleading pictures',
         table(('picture', 'noise (1/m)', *(f'{way}: {one}' for way in WAYS for one in columns)),
               rows),
         f'{len(seeds)} rooms from seed {seeds[0]}; depth from a function with a stated blur of '
         f'{BLUR_PX:g} px, as exact or with smooth noise. The angles are those of all planes that '
         f'have more than {PURE:.0%} of their pixels on one true plane, to that plane. Without: '
         'neither borders nor planes follow the image.')


def _misled(kind: str, sigma: float, seed: int, way: str) -> tuple[float, np.ndarray]:
    """Return SC and the errors of the planes, degrees, with or without the image."""
    if kind == PLAIN:
        scene = textures.textured(rooms.random_room, seed)
        rgb = scene.rgb
    else:
        scene = rooms.random_room(np.random.default_rng(seed))
        rgb = misleading.misleading_image(scene, kind, np.random.default_rng([seed, 3]))
    depth_m = with_disparity_noise(scene.depth_m, sigma, np.random.default_rng([seed, 2]))
    config = Config(segmentation=SegmentationConfig(snap_to_picture=way == 'with'),
                    directions=WAYS[way])
    model = DepthFunction(lambda rgb: depth_m, blur_px=BLUR_PX)
    seen = PlaneDetector(config, model).detect(rgb, scene.intrinsics)
    shared = overlap(scene.labels, seen.labels, np.isfinite(scene.depth_m))
    return (segmentation_covering(shared.counts),
            pure_errors(shared, scene.planes, plane_array(seen))[0])
