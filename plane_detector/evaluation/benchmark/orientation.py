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
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from plane_detector.config import Config, DirectionsConfig, RansacConfig, SegmentationConfig
from plane_detector.depth.depth_function import DepthFunction
from plane_detector.directions.finder import CameraImage, DirectionFinder, Need, find_in_image
from plane_detector.directions.posterior import CLOSE_DEG
from plane_detector.directions.vanishing import SceneDirections
from plane_detector.evaluation.benchmark import options as shared
from plane_detector.evaluation.benchmark.orientation_figure import write_figure
from plane_detector.evaluation.benchmark.real_images import load_network
from plane_detector.evaluation.benchmark.rooms import HELD_OUT
from plane_detector.evaluation.benchmark.tables import emit, table
from plane_detector.evaluation.datasets import Frame, frames, read_frame
from plane_detector.evaluation.metrics import coverage, overlap, segmentation_covering
from plane_detector.evaluation.peers import plane_array
from plane_detector.evaluation.scenes import misleading, rooms, textures
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.sensor_comparison import JudgedPlane, judge_planes
from plane_detector.pipeline import PlaneDetector, segment_planes
from plane_detector.planes.classification import lowest_level, refine_gravity
from plane_detector.types import CameraIntrinsics, PlaneSegmentation

INDOOR = ('kinect', 'nyu', 'living_room', 'kitchen')
# Held-out frames of the long sequence.
HELD_OUT_FRAME = 5
PARTS = ('gravity', 'sequences', 'calibration', 'rendered', 'planes', 'misleading', 'cost')
# Of the probability that is said.
BINS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.01)
PARTS_PER_FRAME = 6
MISLEADING_NOISE_PER_M, BLUR_PX = (0.0, 0.002, 0.008), 3.0
PURE = 0.8
PLAIN = 'doors, planks and tiles'
COST_ROUNDS = 4
UPRIGHT_SINE = 0.05
SCENES: dict[str, Callable] = {
    'rooms': rooms.random_room, 'rooms, camera rolled by 10 deg': textures.rolled_room,
    'rooms, floor rising by 8 deg': textures.ramp_room, 'attics': rooms.attic,
    'hexagonal rooms': rooms.hexagon_room}
WAYS = {'without': DirectionsConfig(gravity=False, orient_planes=False),
        'with': DirectionsConfig()}


@dataclass(frozen=True)
class Errors:
    """
    Errors of the planes of one frame.

    Attributes
    ----------
    judged : tuple of JudgedPlane
    coverage : float
        Share of the sensor's large planes' pixels that a plane with IoU > 0.5 covers.

    """

    judged: tuple[JudgedPlane, ...]
    coverage: float


def angle_deg(first: np.ndarray, second: np.ndarray) -> float:
    """Return the angle between two unit vectors (3,)."""
    return float(np.degrees(np.arccos(np.clip(first @ second, -1, 1))))


def true_down(sensor: PlaneSegmentation) -> np.ndarray | None:
    """Return gravity from the floor in the sensor's depth; None without a floor."""
    down = refine_gravity(sensor.planes, np.array([0.0, 1.0, 0.0]), 40.0)
    floor = None if down is None else lowest_level(sensor.planes, down)
    return None if floor is None else -floor.normal


def report_gravity(name: str, found: Sequence[Frame]) -> None:
    """Print the error of gravity for each frame."""
    rows, errors = [], []
    for frame in found:
        truth = true_down(segment_planes(frame.depth_m, frame.intrinsics))
        seen = _directions(frame.rgb, frame.intrinsics)
        if truth is None or seen.gravity_camera is None:
            rows.append([frame.name, seen.refusal or 'no floor in the sensor\'s depth', '-', '-'])
            continue
        errors.append(angle_deg(seen.gravity_camera, truth))
        rows.append([frame.name, f'{errors[-1]:.1f}', f'{seen.probability:.2f}',
                     seen.pair_refusal or 'yes'])
    emit(f'### Gravity from lines, {name}: {_summary(errors, len(found))}',
         table(('frame', 'error (deg)', 'probability', 'horizontal axes'), rows))


def _directions(rgb: np.ndarray, intrinsics) -> SceneDirections:
    return find_in_image(CameraImage(rgb, intrinsics)).directions


def _summary(errors: Sequence[float], asked: int) -> str:
    if not errors:
        return f'0 of {asked} answer'
    middle, most, worst = np.quantile(errors, (0.5, 0.9, 1.0))
    return (f'{len(errors)} of {asked} answer, median {middle:.2f} deg, nine of ten within '
            f'{most:.2f}, worst {worst:.2f}')


def report_rendered(count: int, first_seed: int) -> None:
    """Print the error of gravity and of the horizontal axes in rendered rooms with lines."""
    rows = []
    for name, make in SCENES.items():
        scenes = [textures.textured(make, seed) for seed in range(first_seed, first_seed + count)]
        seen = [_directions(scene.rgb, scene.intrinsics) for scene in scenes]
        gravity = [angle_deg(one.gravity_camera, scene.gravity_camera)
                   for one, scene in zip(seen, scenes, strict=True)
                   if one.gravity_camera is not None]
        axes = [error for one, scene in zip(seen, scenes, strict=True) if len(one.pairs)
                for error in _axis_errors(one.pairs[0], scene)]
        rows.append([name, _summary(gravity, count), _summary(axes, len(axes))])
    answers = sum(_directions(textures.clutter(np.random.default_rng(seed), textures.VGA),
                              textures.VGA).gravity_camera is not None
                  for seed in range(first_seed, first_seed + count))
    rows.append(['strokes of all directions', f'{answers} of {count} answer', '-'])
    emit('### Directions of rendered rooms with lines',
         table(('scene', 'gravity', 'horizontal axes, if a wall or slope is within 10 deg'), rows))


def report_sequences(data: Path, model: str) -> None:
    """Print how often the vertical is known in images that follow each other."""
    estimate, title = load_network(model)
    rows = []
    for name in INDOOR:
        found = [read_frame(path) for path in sorted((data / name).glob('*_depth.png'))]
        truths = [true_down(segment_planes(frame.depth_m, frame.intrinsics)) for frame in found]
        cells = []
        for depth in ('', title) if estimate else ('',):
            detector, finder, errors = PlaneDetector(Config(), estimate), DirectionFinder(), []
            for frame, truth in zip(found, truths, strict=True):
                disparity = (detector.observe(frame.rgb, frame.intrinsics).disparity if depth
                             else None)
                gravity = finder.look(CameraImage(frame.rgb, frame.intrinsics, None, disparity),
                                      None, Config(), Need.PLANES).gravity
                if gravity.gravity_camera is not None and truth is not None:
                    errors.append(angle_deg(gravity.gravity_camera, truth))
            cells.append(_summary(errors, sum(truth is not None for truth in truths)))
        rows.append([name, *cells])
    emit('### Gravity from images in a row', table(
        ('set', 'lines alone', f'with the normals of {title}'), rows))


def report_calibration(data: Path, count: int, first_seed: int) -> None:
    """Print how many verticals are right, by the probability that is said."""
    rng, said = np.random.default_rng(first_seed), {}
    for frame in frames(data, (*INDOOR, 'real_unlabelled')) if data.is_dir() else ():
        truth = true_down(segment_planes(frame.depth_m, frame.intrinsics))
        for rows, columns in ((slice(None),) * 2, *_parts(frame, rng)):
            if truth is not None:
                said.setdefault('real frames and parts of them', []).append(_said(
                    frame.rgb[rows, columns], frame.intrinsics, (rows, columns), truth))
    for make in SCENES.values():
        for seed in range(first_seed, first_seed + count):
            scene = textures.textured(make, seed)
            said.setdefault('rendered scenes', []).append(_said(
                scene.rgb, scene.intrinsics, (slice(None),) * 2, scene.gravity_camera))
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


def _parts(frame: Frame, rng: np.random.Generator) -> list[tuple[slice, slice]]:
    """Return rows and columns of parts of half to all of the width and height."""
    parts = []
    for _ in range(PARTS_PER_FRAME):
        size = rng.uniform(0.5, 1.0) * np.array(frame.depth_m.shape)
        top, left = rng.uniform(0, np.array(frame.depth_m.shape) - size).astype(int)
        parts.append((slice(top, top + int(size[0])), slice(left, left + int(size[1]))))
    return parts


def _said(rgb: np.ndarray, intrinsics: CameraIntrinsics, part: tuple[slice, slice],
          truth: np.ndarray) -> tuple[float, float]:
    """Return the probability of the most likely vertical of a part, and its error in degrees."""
    own = replace(intrinsics, cx=intrinsics.cx - (part[1].start or 0),
                  cy=intrinsics.cy - (part[0].start or 0), width=rgb.shape[1],
                  height=rgb.shape[0])
    found = _directions(np.ascontiguousarray(rgb), own)
    return found.probability, angle_deg(found.modes.downs[0], truth)


def _axis_errors(axes: np.ndarray, scene) -> list[float]:
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


def report_planes(name: str, found: Sequence[Frame], model: str, seeds: int = 1) -> None:
    """Print the errors of the network's planes with and without directions, for each frame."""
    estimate, title = load_network(model)
    if estimate is None:
        emit(f'Planes of a network: {title}')
        return
    errors = {way: [_joined([_errors(frame, PlaneDetector(
        Config(directions=config, ransac=RansacConfig(seed=seed)), estimate))
        for seed in range(seeds)]) for frame in found] for way, config in WAYS.items()}
    rows = [[frame.name, *(cell for way in WAYS for cell in _cells([errors[way][k]]))]
            for k, frame in enumerate(found)]
    rows.append(['**all**', *(cell for way in WAYS for cell in _cells(errors[way]))])
    worst = max(range(len(found)), key=lambda k: _mean(errors['with'][k].judged,
                                                       'normal_error_deg'))
    columns = ('all (deg)', 'pure (deg)', 'purity', 'offset (cm)', 'coverage')
    emit(f'### Planes of {title}, {name}',
         table(('frame', *(f'{way}: {column}' for way in WAYS for column in columns)), rows),
         f'Means over planes weighted by pixels; pure: more than {PURE:.0%} of the pixels on one '
         f'plane of the sensor. Worst frame: {found[worst].name}. Seeds of RANSAC: {seeds}.')


def report_misleading(count: int, first_seed: int) -> None:
    """Print what pictures that contradict good depth do to it."""
    rows = []
    for kind in (PLAIN, *misleading.KINDS):
        for sigma in MISLEADING_NOISE_PER_M:
            errors = [_misled(kind, sigma, seed)
                      for seed in range(first_seed, first_seed + count)]
            rows.append([kind, f'{sigma:g}', *(cell for way in WAYS
                                               for cell in _misled_cells(errors, way))])
    columns = ('SC', 'mean angle (deg)', 'worst (deg)')
    emit('### Good depth with misleading pictures',
         table(('picture', 'noise (1/m)', *(f'{way}: {one}' for way in WAYS for one in columns)),
               rows),
         f'{count} rooms from seed {first_seed}; depth from a function with a stated blur of '
         f'{BLUR_PX:g} px, as exact or with smooth noise. The angles are those of all planes that '
         f'have more than {PURE:.0%} of their pixels on one true plane, to that plane. Without: '
         'neither borders nor planes follow the image.')


def _misled(kind: str, sigma: float, seed: int) -> dict[str, tuple[float, np.ndarray]]:
    """Return SC and the errors of the planes, degrees, with and without the image."""
    if kind == PLAIN:
        scene = textures.textured(rooms.random_room, seed)
        rgb = scene.rgb
    else:
        scene = rooms.random_room(np.random.default_rng(seed))
        rgb = misleading.misleading_image(scene, kind, np.random.default_rng([seed, 3]))
    depth_m = with_disparity_noise(scene.depth_m, sigma, np.random.default_rng([seed, 2]))
    model = DepthFunction(lambda rgb: depth_m, blur_px=BLUR_PX)
    found = {}
    for way, directions in WAYS.items():
        config = Config(segmentation=SegmentationConfig(snap_to_picture=way == 'with'),
                        directions=directions)
        seen = PlaneDetector(config, model).detect(rgb, scene.intrinsics)
        shared = overlap(scene.labels, seen.labels, np.isfinite(scene.depth_m))
        on_plane = shared.counts[:-1, :-1]
        cosine = (scene.planes[on_plane.argmax(0), :3] * plane_array(seen)[:, :3]).sum(1)
        is_pure = on_plane.max(0) > PURE * shared.counts[:, :-1].sum(0)
        found[way] = (segmentation_covering(shared.counts),
                      np.degrees(np.arccos(np.clip(cosine[is_pure], -1, 1))))
    return found


def _misled_cells(errors: Sequence[dict[str, tuple[float, np.ndarray]]], way: str) -> list[str]:
    angles = np.concatenate([one[way][1] for one in errors])
    return [f'{np.mean([one[way][0] for one in errors]):.4f}', f'{angles.mean():.3f}',
            f'{angles.max():.2f}']


def report_cost(found: Sequence[Frame], model: str) -> None:
    """Print the CPU time of a frame's planes with and without directions."""
    estimate, title = load_network(model)
    if estimate is None:
        emit(f'Cost: {title}')
        return
    cost = np.array([[_cpu_ms(frame, PlaneDetector(Config(directions=config), estimate))
                      for config in WAYS.values()] for frame in found])
    added = cost[:, 1] - cost[:, 0]
    emit('### CPU time of planes from depth, one thread',
         table((*WAYS, 'added: mean (ms)', 'worst'),
               [[*(f'{mean:.1f}' for mean in cost.mean(0)), f'{added.mean():.1f}',
                 f'{added.max():.1f}']]),
         f'{len(found)} frames, {title}; the least of {COST_ROUNDS} rounds of each.')


def _cpu_ms(frame: Frame, detector: PlaneDetector) -> float:
    """Return the shortest time of finding the planes; rounds after the first one also track."""
    seen = detector.observe(frame.rgb, frame.intrinsics)
    cv2.setNumThreads(1)
    times = []
    for _ in range(COST_ROUNDS):
        start = time.thread_time()
        detector.find_planes(seen, detector.look(seen))
        times.append(time.thread_time() - start)
    return 1e3 * min(times[1:])


def _errors(frame: Frame, detector: PlaneDetector) -> Errors:
    found = detector.detect(frame.rgb, frame.intrinsics)
    sensor = segment_planes(frame.depth_m, frame.intrinsics)
    judged = judge_planes(found.labels, plane_array(found), frame.depth_m, frame.intrinsics,
                          np.random.default_rng(0))
    covered = coverage(sensor.labels, found.labels, np.isfinite(frame.depth_m))
    return Errors(tuple(judged), covered.share)


def _joined(errors: Sequence[Errors]) -> Errors:
    """Return the errors of one frame over several seeds."""
    return Errors(tuple(plane for one in errors for plane in one.judged),
                  float(np.mean([one.coverage for one in errors])))


def _cells(errors: Sequence[Errors]) -> list[str]:
    judged = [plane for one in errors for plane in one.judged]
    pure = [plane for plane in judged if plane.purity > PURE]
    shares = [one.coverage for one in errors if np.isfinite(one.coverage)]
    return [f'{_mean(judged, "normal_error_deg"):.1f}', f'{_mean(pure, "normal_error_deg"):.1f}',
            f'{_mean(judged, "purity"):.2f}', f'{100 * _mean(judged, "offset_error_m"):.0f}',
            f'{np.mean(shares) if shares else np.nan:.2f}']


def _mean(judged: Sequence[JudgedPlane], name: str) -> float:
    if not judged:
        return float('nan')
    return float(np.average([getattr(plane, name) for plane in judged],
                            weights=[plane.pixels for plane in judged]))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('--only', choices=PARTS, action='append',
                        help='print this part only; may be given again')
    parser.add_argument('--scenes', type=shared.at_least_one, default=20,
                        help='rendered scenes of each kind')
    parser.add_argument('--seeds', type=shared.at_least_one, default=1,
                        help='seeds of RANSAC, over which the planes are averaged')
    parser.add_argument('--first-seed', type=int, default=HELD_OUT)
    parser.add_argument('--figure', type=Path, help='write the worst answers and the refusals '
                        'among the rendered scenes to this image')
    shared.add_data(parser)
    shared.add_model(parser)


def run(options: argparse.Namespace) -> None:
    """Print all tables."""
    parts = options.only or PARTS
    sets = {name: partial(frames, options.data, (name,)) for name in INDOOR}
    sets['living_room, held out'] = partial(frames, options.data, ('living_room',),
                                            HELD_OUT_FRAME)
    for name, read in sets.items() if options.data.is_dir() else ():
        found = list(read())
        if 'gravity' in parts:
            report_gravity(name, found)
        if 'planes' in parts:
            report_planes(name, found, options.model, options.seeds)
    if 'sequences' in parts and options.data.is_dir():
        report_sequences(options.data, options.model)
    if 'calibration' in parts:
        report_calibration(options.data, options.scenes, options.first_seed)
    if 'cost' in parts and options.data.is_dir():
        report_cost(list(frames(options.data, INDOOR)), options.model)
    if 'misleading' in parts:
        report_misleading(options.scenes, options.first_seed)
    if 'rendered' in parts:
        report_rendered(options.scenes, options.first_seed)
    if options.figure:
        path = write_figure(options.figure, SCENES, options.scenes, options.first_seed)
        emit(f'Figure: `{path}`')
    if not options.data.is_dir():
        emit(f'Real images: {options.data} is not there.')
