# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Fronts for robots: ground, obstacles and drops; situations as programs; the map of planes."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

import plane_detector
from plane_detector import Config, PlaneDetector
from plane_detector.config import DepthConfig, ScaleConfig
from plane_detector.evaluation.benchmark import ground
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.terrain import Kind, View, flat, look, stairs, terrain
from plane_detector.evaluation.scenes.walks import HARD, QVGA
from plane_detector.evaluation.scores.table import HIGHER, LOWER, Draw, Measurement, Values
from plane_detector.types import CameraIntrinsics, Detection, PlaneClass

SEEDS = 24
TERRAINS = ('flat', 'boxes, tables, cables', 'ramp up', 'ramp down', 'kerb down', 'stairs down',
            'stairs up', 'hole', 'quay')
NOISES = (0.001, 0.004, 'kinect')
# A view is bad if a smaller share of the floor or of what joins it is ground, or more of an
# obstacle.
BAD_SHARE = 0.5
SHARES = {Kind.FLOOR: ('own floor', HIGHER), Kind.RAMP: ('ramps', HIGHER),
          Kind.LANDING: ('behind ramps', HIGHER), Kind.OBSTACLE: ('obstacles as ground', LOWER)}


def terrains(draw: Draw) -> Values:
    """Return shares of ground, bad views, and drops found and false, at each noise."""
    values: dict[str, list[float]] = defaultdict(list)
    for name in TERRAINS:
        view = terrain(name, np.random.default_rng([draw.seed, *name.encode()]))
        for noise in NOISES:
            one = ground.judge(view, ground.detect(view, noise, draw.seed))
            title = f'ground, noise {noise}'
            for kind, (what, better) in SHARES.items():
                if (share := one.get(kind.name.lower())) is not None:
                    values[f'{title}: {what}'].append(share)
                    values[f'{title}: {what}, bad views'].append(
                        better * share < better * BAD_SHARE)
            values[f'{title}: views with a false drop'].append(one['false'])
            if 'edge' in one:
                values[f'{title}: length of drops found'].append(one['found'] / one['edge'])
    return values


def range_edges(draw: Draw) -> Values:
    """
    Return how much of the edge of descending stairs is a drop if nothing is visible behind it.

    The camera looks straight ahead, and saw a wall farther than the edge in earlier images.
    """
    rng = np.random.default_rng(draw.seed)
    camera = View(rng.uniform(0.25, 0.4), rng.uniform(0.0, 6.0))
    start_m, far_m = rng.uniform(1.0, 1.8), rng.uniform(3.0, 5.0)
    detector = PlaneDetector(Config(depth=DepthConfig(source='topic'),
                                    scale=ScaleConfig(camera_height=camera.height_m)))

    def detected(view, most_m: float) -> Detection:
        depth_m = with_disparity_noise(view.scene.depth_m, 0.001, rng)
        return detector.detect(view.scene.rgb, view.scene.intrinsics, np.where(
            depth_m > most_m, np.float32(np.nan), depth_m), view.scene.gravity_camera)
    for _ in range(4):
        detected(look(flat(rng, 2.0), camera, rng), far_m)
    view = look(stairs(rng, start_m, -1), camera, rng)
    # The whole staircase is out of sight or too far for the sensor.
    found = detected(view, float(np.nanmax(np.where(
        view.kinds == Kind.FLOOR, view.scene.depth_m, np.nan))))
    edge_m = view.edges_m[view.is_visible]
    if not len(edge_m):
        return {'edge with nothing behind: length of drops found': float('nan')}
    near = np.linalg.norm(edge_m[:, None] - view.in_world(found.drops_m)[None], axis=2) < 0.15 \
        if len(found.drops_m) else np.zeros((len(edge_m), 1), bool)
    return {'edge with nothing behind: length of drops found': near.any(axis=1).mean()}


def _field(draw: Draw, name: str, height_m: float = 0.0, factor: float = 1.0
           ) -> tuple[Detection, dict[str, np.ndarray]]:
    with np.load(draw.data / 'field_cases' / f'{name}.npz') as file:
        found = {key: file[key] for key in file.files}
    raw, matrix = found['depth_mm'], found['K']
    depth_m = np.where(raw > 0, raw * np.float32(factor / 1000), np.nan).astype(np.float32)
    tags = list(found['tags'])
    masks = {tag: found['tag'] == k for k, tag in enumerate(tags)}
    config = Config(depth=DepthConfig(source='topic'), scale=ScaleConfig(camera_height=height_m))
    camera = CameraIntrinsics(matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2],
                              *raw.shape[::-1])
    return (PlaneDetector(config).detect(np.full((*raw.shape, 3), 90, np.uint8), camera, depth_m,
                                         found['gravity']), masks | {'depth': depth_m})


INVALID_M = 65.0  # what is written for it: 65535 mm


def _floor_labelled(found: Detection, masks: Mapping[str, np.ndarray]) -> bool:
    measured = masks['floor'] & (masks['depth'] < INVALID_M)
    return bool((found.labels[measured] >= 0).mean() > 0.98)


def _no_far_plane(found: Detection, masks: Mapping[str, np.ndarray]) -> bool:
    return _floor_labelled(found, masks) and not len(found.drops_m)


def _no_mask_plane(found: Detection, masks: Mapping[str, np.ndarray]) -> bool:
    return _floor_labelled(found, masks) and not (found.labels[masks['deck']] >= 0).any()


def _few_smears(found: Detection, masks: Mapping[str, np.ndarray]) -> bool:
    smeared = masks['none'] & np.isfinite(masks['depth'])
    return bool(found.obstacles[smeared].mean() < 0.1) if smeared.any() else True


# Each situation: the camera height if stated, the factor on the depth, what is correct.
FIELD: dict[str, tuple[str, float, float, Callable[..., bool]]] = {
    'a round thing alone': ('round_obstacle_only', 0.6, 1, lambda found, masks: (
        found.obstacles.size > 0 and found.obstacles[masks['bush']].mean() > 0.98)),
    'a camera on its side before an edge': (
        'drop_camera_turned_90', 1.0, 1, lambda found, masks: (
            len(found.drops_m) > 50 and not found.obstacles[masks['floor']].mean() > 0.01)),
    'the body masked by 5 m': ('body_masked_by_5m', 0, 1, _no_mask_plane),
    'invalid is 65535': ('invalid_is_65535', 0, 1, _no_far_plane),
    'a range limit of 2 m': ('range_limit_2m', 0, 1, lambda found, _: not len(found.drops_m)),
    'a reflecting floor': ('floor_reflects_ceiling', 0, 1, lambda found, _: (
        not len(found.drops_m))),
    **{f'a unit that is wrong by {factor:g}': (
        'wrong_unit', 0.6, factor, lambda found, _: bool(found.ground_result.drop_note))
       for factor in (10, 1000, 0)},
    'depth bent by 8 %': ('depth_bent_8_percent', 0, 1, lambda found, masks: (
        found.obstacles[masks['floor']].mean() < 0.01)),
    'specks': ('specks', 0, 1, lambda found, masks: (
        found.obstacles[masks['none']].sum() < 65)),
    'flying pixels': ('flying_pixels', 0, 1, _few_smears),
    'the own deck': ('own_deck', 1.0, 1, lambda found, masks: (
        not len(found.drops_m) and PlaneClass.FLOOR in found.classes)),
    'parked at a table': ('parked_at_table', 1.3, 1, lambda found, _: not len(found.drops_m))}


def field_cases(draw: Draw) -> Values:
    """Return the share of situations from public reports in which everything is correct."""
    right = []
    for name, height_m, factor, is_right in FIELD.values():
        found, masks = _field(draw, name, height_m, factor)
        right.append(bool(is_right(found, masks)))
    return {'field cases: right': right}


def case(draw: Draw) -> Values:
    """Return the share of the lines of a program that say PASS."""
    run = subprocess.run([sys.executable, str(draw.cases / draw.part), str(draw.seed)],
                         capture_output=True, text=True, check=False,
                         env=_environment())
    words = [line.split(' ', 1)[0] for line in run.stdout.splitlines()]
    passed, failed = words.count('PASS'), words.count('FAIL')
    if not passed + failed:
        raise RuntimeError(f'{draw.part}: {run.stderr.strip()[-200:]}')
    return {f'case {Path(draw.part).stem}: right': [1.0] * passed + [0.0] * failed}


def _environment() -> dict[str, str]:
    return {**os.environ, 'PYTHONPATH': str(Path(plane_detector.__file__).parents[1]),
            **dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS'), '1')}


CASES = ('blind_spots', 'edges_smeared', 'height_drift', 'landing', 'level_kinect_stairs',
         'low_camera', 'pallet', 'ray_distance', 'rig_from_above', 'sidewalk', 'stairs_egg',
         'submillimetre', 'tof_near_floor')
MAP_IMAGES = 60
MAPS = {'box rooms': (('box',), '', ('drift', 'jump 30')),
        'hard rooms': (HARD, '', ('drift', 'jump 30')),
        'people, and a crate that goes': (('crate',), 'people', ('drift',))}


def mapped(draw: Draw) -> Values:
    """Return what is found, invented, left over and relabelled on a walk through a room."""
    # Here: with --against, this module must be imported where there was no map yet.
    from plane_detector.evaluation.benchmark import map
    title, room = draw.part.split(': ')
    values: dict[str, float] = {}
    _, variant, kinds = MAPS[title]
    recording = map.record(room, draw.seed, 0.001, MAP_IMAGES, QVGA, variant)
    for kind in kinds:
        got = map.score(recording, kind, draw.seed)
        name = f'map, {title}, {kind}'
        values |= {f'{name}: surfaces found': got.found / max(got.surfaces, 1),
                   f'{name}: planes of no surface': got.of_none / max(got.planes, 1),
                   f'{name}: planes left of what went': got.left,
                   f'{name}: labels switched': got.switches / max(got.seen, 1),
                   f'{name}: IoU': float(np.median(got.overlaps)),
                   f'{name}: jumps missed or false': abs(
                       got.jumps - kind.startswith('jump'))}
    return values


MEASUREMENTS = (
    Measurement('ground', terrains, {name: better for noise in NOISES for name, better in (
        *((f'ground, noise {noise}: {what}', better) for what, better in SHARES.values()),
        *((f'ground, noise {noise}: {what}, bad views', LOWER) for what, _ in SHARES.values()),
        (f'ground, noise {noise}: views with a false drop', LOWER),
        (f'ground, noise {noise}: length of drops found', HIGHER))}, draws=SEEDS),
    Measurement('ground', range_edges, {'edge with nothing behind: length of drops found': HIGHER},
                draws=SEEDS),
    Measurement('ground', field_cases, {'field cases: right': HIGHER}, needs=('data',)),
    *(Measurement('cases', case, {f'case {name}: right': HIGHER}, parts=(f'{name}.py',),
                  needs=('cases',)) for name in CASES),
    *(Measurement('map', mapped, {f'map, {title}, {kind}: {what}': better for kind in kinds
                                  for what, better in (
        ('surfaces found', HIGHER), ('planes of no surface', LOWER),
        ('planes left of what went', LOWER), ('labels switched', LOWER), ('IoU', HIGHER),
        ('jumps missed or false', LOWER))}, draws=2 if title == 'hard rooms' else 4,
        parts=tuple(f'{title}: {room}' for room in rooms))
      for title, (rooms, _, kinds) in MAPS.items()))
