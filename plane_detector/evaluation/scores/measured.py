# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Fronts of measured depth: rendered scenes, frames of real sensors, cameras of any mounting."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import product
from pathlib import Path

import cv2
import numpy as np

from plane_detector import Config, PlaneDetector, segment_planes
from plane_detector.config import DepthConfig, RansacConfig, SegmentationConfig
from plane_detector.depth.observation import DepthFunction
from plane_detector.evaluation.benchmark.labelled import (
    ABW_MIN_SHARE,
    KEPT_SHARE,
    NOISE_SHARE,
    hoover_numbers,
    share_in_one_plane,
)
from plane_detector.evaluation.benchmark.samples import (
    CURVED,
    curved_scene,
    furnished,
    labelled_numbers,
    noisy_depth,
    room,
)
from plane_detector.evaluation.datasets import (
    ABW,
    OF_TODAY,
    TABLETOPS,
    LabelledFrame,
    labelled_frames,
    read_frame,
)
from plane_detector.evaluation.metrics import overlap, pure_errors, segmentation_covering
from plane_detector.evaluation.peers import plane_array
from plane_detector.evaluation.scenes.misleading import KINDS, misleading_image
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rendering import Scene, camera_rotation, render
from plane_detector.evaluation.scenes.rooms import corridor, furnished_room
from plane_detector.evaluation.scenes.sensor_cases import SENSOR_CASES
from plane_detector.evaluation.scenes.sensors import SENSORS
from plane_detector.evaluation.scenes.textures import room_from_above, textured
from plane_detector.evaluation.scores.classes import class_shares, classes_of_planes
from plane_detector.evaluation.scores.clips import QUARTER_TURN, Shot
from plane_detector.evaluation.scores.table import HIGHER, LOWER, Draw, Measurement, Values
from plane_detector.types import CameraIntrinsics

ROOM_NOISES, LIVED_IN_NOISES = (0.0, 0.001, 0.004, 0.01), (0.0, 0.001, 0.01)
CURVED_NOISES = (0.0, 0.004)
KINDS_OF_ROOMS = {'rooms': (room, ROOM_NOISES), 'lived-in rooms': (furnished, LIVED_IN_NOISES)}
SETS = {'nyu_planes_dpd': 'NYU by hand', TABLETOPS: 'tables', 'icl_office_evops': 'office',
        OF_TODAY: 'sensors'}
VIDEOS = ('d435_standing', 'd435_moving', 'kitchen_30hz')
BLINKING_DRAWS, BLINKING_SHARE = 20, 0.02
"""Number of draws of new noise on one frame; planes over this share of the image must persist."""
HOLES = 0.2
SMALL_STEPS = Path(__file__).with_name('small_steps.json')
# chosen: sizes of real cameras, with the same field of view.
SIZES = {'640 x 480': 1, '320 x 240': 2, '160 x 120': 4}


def seeded(seed: int, source: str = 'topic') -> Config:
    """Return the defaults for measured depth with a seed of RANSAC."""
    return Config(depth=DepthConfig(source=source), ransac=RansacConfig(seed=seed))


def covering(labels: np.ndarray, scene: Scene) -> float:
    """Return the covering of predicted labels in a rendered scene."""
    return segmentation_covering(overlap(scene.labels, labels,
                                         np.isfinite(scene.depth_m)).counts)


def rendered(draw: Draw) -> Values:
    """Return the covering at each noise and of each simulated sensor."""
    make, noises = KINDS_OF_ROOMS[draw.part]
    scene = make(draw.seed)
    return {f'{draw.part}, noise {noise:g}: SC' if not isinstance(noise, str)
            else f'{noise}: SC': covering(segment_planes(
                noisy_depth(scene, noise, draw.seed), scene.intrinsics).labels, scene)
            for noise in (*noises, *SENSORS)}


def curved(draw: Draw) -> Values:
    """Return the share of a curved object in planes, and the least IoU of wall and floor."""
    shares, ious = {noise: [] for noise in CURVED_NOISES}, []
    for index in range(int(draw.part), len(CURVED), 4):
        scene = curved_scene(index)
        seen = np.isfinite(scene.depth_m)
        for noise in CURVED_NOISES:
            labels = segment_planes(noisy_depth(scene, noise, draw.seed),
                                    scene.intrinsics).labels
            shares[noise].append((labels[seen & (scene.labels < 0)] >= 0).mean())
            ious.append(overlap(scene.labels, labels, seen).iou.max(axis=1).min())
    return {**{f'curved, noise {noise:g}: share in planes': share
               for noise, share in shares.items()}, 'curved: least IoU of wall and floor': ious}


def sensor_cases(draw: Draw) -> Values:
    """Return the share of the largest surface in one plane, of errors that bend it."""
    scene, depth_m = SENSOR_CASES[draw.part](np.random.default_rng(draw.seed))
    frame = LabelledFrame('', '', scene.rgb, depth_m, scene.intrinsics, scene.labels)
    labels = segment_planes(depth_m, scene.intrinsics).labels
    return {f'{draw.part}: largest surface in one plane': share_in_one_plane(labels, frame)}


@lru_cache(maxsize=1)
def _labelled(data: Path) -> tuple[LabelledFrame, ...]:
    return tuple(labelled_frames(data))


def by_hand(draw: Draw) -> Values:
    """Return the covering, the recall and whether the largest surface is whole, by set."""
    values: dict[str, list[float]] = {}
    for frame in _labelled(draw.data):
        if frame.set_name not in SETS:
            continue
        numbers = labelled_numbers(frame, segment_planes(
            frame.depth_m, frame.intrinsics, seeded(draw.seed)).labels)
        name = SETS[frame.set_name]
        values.setdefault(f'{name}: SC', []).append(numbers['SC'])
        if frame.set_name == OF_TODAY:
            values.setdefault('sensors: recall', []).append(numbers['recall'])
            values.setdefault('sensors: largest surface whole', []).extend(_whole(frame, draw))
    return values


def _whole(frame: LabelledFrame, draw: Draw) -> list[bool]:
    """Return whether the largest surface is one plane as given, with fresh noise and half size."""
    noise = np.random.default_rng(draw.seed).standard_normal(frame.depth_m.shape)
    noisy = replace(frame, depth_m=(frame.depth_m * (1 + NOISE_SHARE * noise)).astype(np.float32))
    half = replace(frame, depth_m=np.ascontiguousarray(frame.depth_m[::2, ::2]),
                   labels=frame.labels[::2, ::2],
                   intrinsics=reduced(frame.intrinsics, frame.depth_m[::2, ::2], 2))
    return [share_in_one_plane(segment_planes(one.depth_m, one.intrinsics,
                                              seeded(draw.seed)).labels, one) >= KEPT_SHARE
            for one in (frame, noisy, half)]


def reduced(camera: CameraIntrinsics, image: np.ndarray, step: int) -> CameraIntrinsics:
    """Return the camera of an image (h, w) of which each ``step``-th row and column is left."""
    return CameraIntrinsics(camera.fx / step, camera.fy / step, camera.cx / step,
                            camera.cy / step, image.shape[1], image.shape[0])


def scanned(draw: Draw) -> Values:
    """Return the correct regions of ABW, and the covering with the default settings."""
    values: dict[str, list[float]] = {'ABW: correct regions': [], 'ABW: SC': []}
    config = seeded(draw.seed)
    fine = replace(config, segmentation=SegmentationConfig(min_plane_share=ABW_MIN_SHARE))
    for frame in _labelled(draw.data):
        if frame.set_name == ABW:
            fine_labels, labels = (segment_planes(frame.depth_m, frame.intrinsics, one).labels
                                   for one in (fine, config))
            values['ABW: correct regions'].append(hoover_numbers(frame, fine_labels)['correct'])
            values['ABW: SC'].append(labelled_numbers(frame, labels)['SC'])
    return values


def mounted(draw: Draw) -> Values:
    """Return covering and classes of cameras on their side, upside down, and from above."""
    values: dict[str, float] = {}
    rectangles, rotation, position = furnished_room(np.random.default_rng(draw.seed))
    for degrees in (0, 90, 180, 270):
        turn = camera_rotation(0, 0, 0).T @ camera_rotation(0, 0, degrees)
        name = f'turned by {degrees}' if degrees else 'upright camera'
        values |= _with_classes(name, render(
            rectangles, rotation @ turn, position, room(draw.seed).intrinsics,
            np.random.default_rng(draw.seed)), draw)
    return values | _with_classes('from above', room_from_above(
        np.random.default_rng(draw.seed), room(draw.seed).intrinsics), draw)


def _with_classes(name: str, scene: Scene, draw: Draw) -> dict[str, float]:
    depth_m = noisy_depth(scene, 0.001, draw.seed)
    found = PlaneDetector(seeded(0)).detect(scene.rgb, scene.intrinsics, depth_m,
                                            scene.gravity_camera)
    right, wrong = class_shares(found, classes_of_planes(scene), scene.labels)
    return {f'{name}: SC': covering(found.labels, scene), f'{name}: right classes': right,
            f'{name}: wrong classes': wrong}


def sizes(draw: Draw) -> Values:
    """Return the covering of small images, also with holes in a fifth of their pixels."""
    scene, values = room(draw.seed), {}
    depth_m = noisy_depth(scene, 0.001, draw.seed)
    holes = np.random.default_rng([draw.seed, 5]).random(depth_m.shape) < HOLES
    for name, step in SIZES.items():
        for title, own_m in (('', depth_m), (', 20 % holes', np.where(holes, np.nan, depth_m))):
            part_m = np.ascontiguousarray(own_m[::step, ::step], np.float32)
            labels = segment_planes(part_m, reduced(scene.intrinsics, part_m, step)).labels
            seen = np.isfinite(part_m)
            values[f'{name}{title}: SC'] = segmentation_covering(
                overlap(scene.labels[::step, ::step], labels, seen).counts)
    return values


NEAR_NOISES = (0.0005, 0.001, 0.002)


def near_fronts(draw: Draw) -> Values:
    """
    Return how much of an obstacle right in front of the robot is detected.

    A box parallel to the image, .3 to .5 m ahead of a camera that looks along a level floor, in
    whole millimetres with noise that grows with the square of the distance, which is less than a
    millimetre on the box: all its pixels have one value.
    """
    rng = np.random.default_rng(draw.seed)
    camera, labelled, obstacles = room(draw.seed).intrinsics, [], []
    v = np.arange(camera.height)[:, None] + np.zeros(camera.width)
    height_m = rng.uniform(0.3, 0.8)
    with np.errstate(divide='ignore'):
        floor_m = np.where(v > camera.cy, height_m * camera.fy / (v - camera.cy), np.inf)
    z_m = np.minimum(floor_m, rng.uniform(3.0, 5.0))
    top, left = rng.integers(120, 220), rng.integers(100, 260)
    box = (slice(top, 400), slice(left, left + 240))
    z_m[box] = np.minimum(z_m[box], rng.uniform(0.3, 0.5))
    for k in NEAR_NOISES:
        depth_m = np.round(z_m + k * z_m**2 * rng.standard_normal(z_m.shape), 3)
        found = PlaneDetector(seeded(0)).detect(
            np.full((*z_m.shape, 3), 128, np.uint8), camera, depth_m.astype(np.float32),
            np.array([0.0, 1.0, 0.0]), camera_height_m=height_m)
        labelled.append((found.labels[box] >= 0).mean())
        obstacles.append(found.obstacles[box].mean() if found.obstacles.size else 0.0)
    return {'near front: share in planes': labelled, 'near front: share of obstacles': obstacles}


STATED_NOISES = (0.0, 0.006)
"""Stated noise of a network: none, or that of the best network of the zoo."""


def misleading(draw: Draw) -> Values:
    """Return how much worse planes are with misleading pictures than with good depth alone."""
    scene, values = room(draw.seed), {'turned': [], 'worse': [], 'lost': []}
    noisy_m = noisy_depth(scene, 0.002, draw.seed)
    for kind in KINDS:
        rgb = misleading_image(scene, kind, np.random.default_rng([draw.seed, 3]))
        for depth_m, noise_share in product((scene.depth_m, noisy_m), STATED_NOISES):
            model = DepthFunction(lambda rgb, depth_m=depth_m: depth_m, noise_share=noise_share,
                                  blur_px=3)
            with_picture = PlaneDetector(depth_model=model).detect(rgb, scene.intrinsics)
            alone = segment_planes(depth_m, scene.intrinsics)
            (errors_deg, covered), (alone_deg, alone_covered) = (
                _errors(scene, found) for found in (with_picture, alone))
            if depth_m is scene.depth_m:
                values['turned'].append(errors_deg.max(initial=0.0))
            values['worse'].append(errors_deg.mean() - alone_deg.mean())
            values['lost'].append(max(alone_covered - covered, 0.0))
    return {'misleading pictures, exact depth: worst plane (deg)': values['turned'],
            'misleading pictures: planes turned from the depth alone (deg)': values['worse'],
            'misleading pictures: SC lost to the depth alone': values['lost']}


def corridors(draw: Draw) -> Values:
    """Return errors of planes in corridors by a good network, with its camera in four turns."""
    scene, worst, lost = textured(corridor, draw.seed), [], []
    depth_m = with_disparity_noise(scene.depth_m, 0.004, np.random.default_rng([draw.seed, 2]),
                                   0.9, 24.0)
    shot = Shot(scene.rgb, depth_m, scene.intrinsics, scene.gravity_camera, 0.0)
    for quarters in range(4):
        view, labels = shot.turned(quarters), np.rot90(scene.labels, quarters)
        own_m, planes = view.depth_m, scene.planes.copy()
        planes[:, :3] = planes[:, :3] @ np.linalg.matrix_power(QUARTER_TURN, quarters).T
        for output, values in (('metric_depth', own_m),
                               ('relative_disparity', 3 / own_m + np.float32(0.2))):
            model = DepthFunction(lambda rgb, values=values: values, output,
                                  noise_share=0.01, blur_px=3)
            found = PlaneDetector(seeded(draw.seed, 'model'), model).detect(
                view.rgb, view.intrinsics)
            shared = overlap(labels, found.labels, np.isfinite(own_m))
            worst.append(pure_errors(shared, planes, plane_array(found))[0].max(initial=0.0))
            large = shared.counts[:-1].sum(axis=1) > 0.02 * labels.size
            lost.append(np.count_nonzero(shared.iou[large].max(axis=1, initial=0.0) < 0.5))
    return {'corridors by a network: worst plane (deg)': worst,
            'corridors by a network: surfaces lost per image': lost}


def _errors(scene: Scene, found) -> tuple[np.ndarray, float]:
    shared = overlap(scene.labels, found.labels, np.isfinite(scene.depth_m))
    return (pure_errors(shared, scene.planes, plane_array(found))[0],
            segmentation_covering(shared.counts))


def small_steps(draw: Draw) -> Values:
    """
    Return the shares of real steps of 1 to 5 cm that are separated, and of surfaces kept whole.

    The file has rectangles strictly inside surfaces, row and column of two corners each. Pairs are
    nearly parallel, and each is 1 to 5 cm off the plane through the other: magazines and books on
    tables, parts in a bin, drawers, a picture, a calendar, tiles, and neighbours among the labels
    of ABW. Half of the pairs that are not from ABW were chosen by the pictures alone.
    """
    told, whole = [], []
    for name, found in json.loads(SMALL_STEPS.read_text()).items():
        scans = [one for one in _labelled(draw.data) if f'{one.set_name}/{one.name}' == name]
        frame = scans[0] if scans else read_frame(draw.data / f'{name}_depth.png')
        for step in (1, 2):  # the image, and half its size
            depth_m = np.ascontiguousarray(frame.depth_m[::step, ::step])
            labels = segment_planes(depth_m, reduced(frame.intrinsics, depth_m, step),
                                    seeded(draw.seed)).labels
            for pair in found.get('steps', ()):
                (low, low_share), (high, high_share) = (
                    _main_label(labels, np.array(one) // step) for one in pair)
                told.append(low != high and min(low_share, high_share) > 0.5)
            whole += [_main_label(labels, np.array(one) // step)[1] >= KEPT_SHARE
                      for one in found.get('whole', ())]
    return {'steps of 1 to 5 cm: told apart': told, 'surfaces beside them: whole': whole}


def _main_label(labels: np.ndarray, corners: Sequence[int]) -> tuple[int, float]:
    """Return the label that most of a rectangle has, and its share; -1 and 0 without any."""
    top, left, bottom, right = corners
    counts = np.bincount(labels[top:bottom, left:right].ravel() + 1)
    counts[0] = 0
    label = int(counts.argmax())
    return label - 1, float(counts[label] / ((bottom - top) * (right - left)))


def lost_planes(before: np.ndarray, after: np.ndarray,
                seen: np.ndarray) -> tuple[int, list[tuple[int, int]]]:
    """
    Return how many large planes of an image have none in the next one, and the pairs.

    Only pixels with depth in both images, ``seen``, count: where holes flicker, no plane is lost.
    """
    shared = overlap(before, after, seen)
    large = np.flatnonzero(shared.counts[:-1].sum(axis=1) > BLINKING_SHARE * before.size)
    if not shared.iou.shape[1]:
        return len(large), []
    best = shared.iou[large].argmax(axis=1)
    is_kept = shared.iou[large, best] > 0.5
    return (int(np.count_nonzero(~is_kept)),
            list(zip(large[is_kept].tolist(), best[is_kept].tolist(), strict=True)))


def blinking(draw: Draw) -> Values:
    """Return how often planes of a still frame are lost between draws of new noise."""
    values: Values = {f'blinking of still frames{how}: {what}': [] for how in ('', ', memory')
                      for what in ('planes lost per image', 'pairs that lose a plane')}
    for frame in _labelled(draw.data)[draw.part::2]:
        if frame.set_name != OF_TODAY:
            continue
        rng, seen = np.random.default_rng(draw.seed), np.isfinite(frame.depth_m)
        noisy_m = [(frame.depth_m * (1 + NOISE_SHARE * rng.standard_normal(seen.shape))
                    ).astype(np.float32) for _ in range(BLINKING_DRAWS)]
        stream, black = PlaneDetector(seeded(draw.seed)), np.zeros((*seen.shape, 3), np.uint8)
        camera = frame.intrinsics
        for how, labels in (
                ('', [segment_planes(depth_m, camera).labels for depth_m in noisy_m]),
                (', memory', [stream.detect(black, camera, depth_m, stamp_s=k / 30).labels
                              for k, depth_m in enumerate(noisy_m)])):
            lost = [lost_planes(before, after, seen)[0]
                    for before, after in zip(labels[:-1], labels[1:], strict=True)]
            for what, value in (('planes lost per image', np.mean(lost)),
                                ('pairs that lose a plane', np.mean(np.array(lost) > 0))):
                values[f'blinking of still frames{how}: {what}'].append(float(value))
    return values


def video(draw: Draw) -> Values:
    """Return planes lost between images of a video, and labels that change."""
    detector, lost, switched, last = PlaneDetector(seeded(draw.seed)), [], [], None
    for k, path in enumerate(sorted((draw.data / 'videos' / draw.part).glob('*_depth.png'))):
        about = json.loads((path.parent / 'intrinsics.json').read_text())
        raw = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        depth_m = raw.astype(np.float32) * np.float32(about['depth_unit_m'])
        depth_m[raw == 0] = np.nan
        found = detector.detect(np.zeros((*raw.shape, 3), np.uint8), CameraIntrinsics(*(
            about[key] for key in ('fx', 'fy', 'cx', 'cy', 'width', 'height'))), depth_m,
            stamp_s=k / 30)
        if last is not None:
            count, pairs = lost_planes(last.labels, found.labels,
                                       np.isfinite(last.depth_m) & np.isfinite(found.depth_m))
            lost.append(count)
            switched.append(sum(last.planes[i].label != found.planes[j].label for i, j in pairs))
        last = found
    return {f'{draw.part}: planes lost per image': lost,
            f'{draw.part}: labels switched per image': switched}


MEASUREMENTS = (
    Measurement('measured', rendered, {
        **{f'rooms, noise {noise:g}: SC': HIGHER for noise in ROOM_NOISES},
        **{f'lived-in rooms, noise {noise:g}: SC': HIGHER for noise in LIVED_IN_NOISES},
        **{f'{sensor}: SC': HIGHER for sensor in SENSORS}}, draws=16, parts=tuple(KINDS_OF_ROOMS)),
    Measurement('measured', curved, {
        **{f'curved, noise {noise:g}: share in planes': LOWER for noise in CURVED_NOISES},
        'curved: least IoU of wall and floor': HIGHER}, draws=2, parts=(0, 1, 2, 3)),
    *(Measurement('measured', sensor_cases, {f'{name}: largest surface in one plane': HIGHER},
                  draws=6, parts=(name,)) for name in SENSOR_CASES),
    Measurement('measured', by_hand, {
        **{f'{name}: SC': HIGHER for name in SETS.values()}, 'sensors: recall': HIGHER,
        'sensors: largest surface whole': HIGHER}, draws=6, needs=('data',)),
    Measurement('measured', scanned, {'ABW: correct regions': HIGHER, 'ABW: SC': HIGHER}, draws=3,
                needs=('data',)),
    Measurement('measured', misleading, {
        'misleading pictures, exact depth: worst plane (deg)': LOWER,
        'misleading pictures: planes turned from the depth alone (deg)': LOWER,
        'misleading pictures: SC lost to the depth alone': LOWER}, draws=8),
    Measurement('measured', corridors, {
        'corridors by a network: worst plane (deg)': LOWER,
        'corridors by a network: surfaces lost per image': LOWER}, draws=8),
    Measurement('cameras', mounted, {
        f'{name}: {what}': better for name in (
            'upright camera', 'turned by 90', 'turned by 180', 'turned by 270', 'from above')
        for what, better in (('SC', HIGHER), ('right classes', HIGHER), ('wrong classes', LOWER))},
        draws=12),
    Measurement('cameras', sizes, {
        f'{name}{title}: SC': HIGHER for name in SIZES for title in ('', ', 20 % holes')},
        draws=12),
    Measurement('cameras', near_fronts, {'near front: share in planes': HIGHER,
                                         'near front: share of obstacles': HIGHER}, draws=16),
    Measurement('steps', small_steps, {'steps of 1 to 5 cm: told apart': HIGHER,
                                       'surfaces beside them: whole': HIGHER}, draws=4,
                needs=('data',)),
    Measurement('blinking', blinking, {
        f'blinking of still frames{how}: {what}': LOWER for how in ('', ', memory')
        for what in ('planes lost per image', 'pairs that lose a plane')},
        draws=2, parts=(0, 1), needs=('data',)),
    *(Measurement('blinking', video, {f'{name}: planes lost per image': LOWER,
                                      f'{name}: labels switched per image': LOWER}, draws=12,
                  parts=(name,), needs=('data',)) for name in VIDEOS))
