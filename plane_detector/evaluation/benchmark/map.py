# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Benchmark of the map of planes, on rendered walks with poses of several kinds."""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from plane_detector import Config, PlaneDetector
from plane_detector.config import DepthConfig
from plane_detector.evaluation.benchmark.report import (
    add_shared,
    at_least_one,
    emit,
    in_parallel,
    table,
)
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rendering import Rectangle, Scene
from plane_detector.evaluation.scenes.sensors import SENSORS
from plane_detector.evaluation.scenes.walks import (
    HARD,
    QVGA,
    Walk,
    standing,
    walk,
    with_errors,
    with_people,
)
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.mapping.heights import PlaneFrames, heights_of
from plane_detector.mapping.map_plane import MapPlane
from plane_detector.mapping.plane_map import PlaneMap
from plane_detector.planes.outline import PlacedDetection
from plane_detector.types import CameraIntrinsics, Detection, Plane, Planes

# A surface counts if it covers this share of the pixels in this many images.
LEAST_SHARE, LEAST_IMAGES, LEAST_SIDE_M = 0.006, 4, 0.1
# A cell of a plane is on a surface within these; if there are several, the nearest one counts.
NEAR_M, SAME_SIDE = 0.03, np.cos(np.radians(10.0))
CELL_M = 0.04


@dataclass(frozen=True)
class Recording:
    """A rendered walk with its detections, for every kind of poses."""

    walked: Walk
    detections: tuple[Detection, ...]
    intrinsics: CameraIntrinsics
    labels: tuple[np.ndarray, ...]  # (h, w) int16, surface of every second pixel; -1 none
    regions: Mapping[int, np.ndarray]  # (N, 2) int, cells of each surface that counts


def record(name: str, seed: int, noise: float | str, images: int, intrinsics: CameraIntrinsics,
           variant: str = '') -> Recording:
    """Render a walk and detect in it."""
    rng = np.random.default_rng([seed, *name.encode()])
    walked = walk(name, rng, images)
    if variant == 'people':
        walked = with_people(walked, rng)
    elif variant == 'standing':
        walked = standing(walked, images)
    detector = PlaneDetector(Config(depth=DepthConfig(source='topic')))
    detections, labels = [], []
    cells: dict[int, list[np.ndarray]] = defaultdict(list)
    shares: dict[int, int] = defaultdict(int)
    for k in range(images):
        scene = walked.scene(k, intrinsics, rng)
        depth_m = (SENSORS[noise](scene.depth_m, intrinsics, rng) if isinstance(noise, str)
                   else with_disparity_noise(scene.depth_m, noise, rng))
        found = detector.detect(scene.rgb, intrinsics, depth_m, scene.gravity_camera)
        detections.append(found)
        surfaces = np.append(scene.rectangles, -1)[scene.labels]
        labels.append(surfaces[::2, ::2].astype(np.int16))
        _add_cells(walked, k, scene, surfaces, cells)
        for surface, count in zip(*np.unique(surfaces, return_counts=True), strict=True):
            shares[surface] += count >= LEAST_SHARE * surfaces.size
    regions = {surface: np.unique(np.concatenate(cells[surface]), axis=0)
               for surface, times in sorted(shares.items())
               if 0 <= surface < len(walked.surfaces) and times >= LEAST_IMAGES
               and _least_side_m(walked.surfaces[surface]) >= LEAST_SIDE_M}
    return Recording(walked, tuple(detections), intrinsics, tuple(labels), regions)


def _add_cells(walked: Walk, index: int, scene: Scene, surfaces: np.ndarray,
               cells: Mapping[int, list[np.ndarray]]) -> None:
    v, u = np.indices(surfaces.shape)
    camera = scene.intrinsics
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy,
                     np.ones(u.shape)], axis=-1)
    points_m = walked.poses[index].points(rays * scene.depth_m[..., None].astype(float))
    for surface in np.unique(surfaces):
        if 0 <= surface < len(walked.surfaces):
            flat_m = along_face(walked.surfaces[surface], points_m[surfaces == surface])[:, :2]
            cells[surface].append(np.unique(np.floor(flat_m / CELL_M).astype(int), axis=0))


def _least_side_m(face: Rectangle) -> float:
    return min(np.linalg.norm(face.edge_u), np.linalg.norm(face.edge_v))


def along_face(face: Rectangle, points_m: np.ndarray) -> np.ndarray:
    """Return points (N, 3) along the edges and the normal of a rectangle, metres."""
    u, v = (edge / np.linalg.norm(edge) for edge in (face.edge_u, face.edge_v))
    return (points_m - face.corner) @ np.array([u, v, np.cross(u, v)]).T


@dataclass
class Score:
    """Counts and errors of one walk or of several."""

    surfaces: int = 0
    found: int = 0
    planes: int = 0
    of_none: int = 0
    pieces: int = 0  # planes of found surfaces
    switches: int = 0
    seen: int = 0  # number of times that a surface was seen again
    jumps: int = 0
    left: int = 0  # planes on removed objects
    overlaps: tuple[float, ...] = ()
    offsets_m: tuple[float, ...] = ()
    squared: tuple[float, ...] = ()
    seconds: tuple[float, ...] = ()

    def __add__(self, other: Score) -> Score:
        return Score(*(getattr(self, name) + getattr(other, name)
                       for name in self.__dataclass_fields__))


def score(recording: Recording, kind: str, seed: int) -> Score:
    """Run the map over a recording with poses of a kind, and compare it with the truth."""
    walked, result, planes = recording.walked, Score(), PlaneMap()
    given = with_errors(walked.poses, kind, np.random.default_rng([seed, *kind.encode()]))
    last: dict[int, int] = {}
    taken: dict[int, int] = {}
    seconds = []
    for k, detection in enumerate(recording.detections):
        placed = PlacedDetection(detection, recording.intrinsics, given[k], 0.1 * k)
        start_s = time.thread_time()
        update = planes.update(placed)
        seconds.append(time.thread_time() - start_s)
        result.jumps += update.jump_m > 0
        taken.update(update.subsumed)
        for surface, label in _shown(recording, k, detection, update.labels):
            while last.get(surface) in taken:
                last[surface] = taken[last[surface]]
            result.seen += surface in last
            result.switches += last.get(surface, label) != label
            last[surface] = label
    snapshot = planes.snapshot()
    # From the planes according to the last pose to the true world.
    to_world = walked.poses[-1].after(given[-1].inverse())
    return replace(result, seconds=tuple(seconds)) + compare(
        recording, snapshot.surfaces, snapshot.planes.moved(to_world),
        to_world.after(snapshot.to_poses))


def _shown(recording: Recording, index: int, detection: Detection, labels: np.ndarray
           ) -> Iterable[tuple[int, int]]:
    """Yield surfaces of an image, and the label in the map of the found plane on most of each."""
    truth, found = recording.labels[index], detection.labels[::2, ::2]
    for surface in recording.regions:
        on_it = found[(truth == surface) & (found >= 0) & (found < len(labels))]
        if on_it.size < LEAST_SHARE * truth.size / 2:
            continue
        counts = np.bincount(on_it)
        label = labels[np.argmax(counts)]
        if label and counts.max() > 0.5 * on_it.size:
            yield surface, int(label)


def compare(recording: Recording, planes: Sequence[MapPlane], coefficients: Planes,
            to_world: RigidTransform) -> Score:
    """Compare planes with the surfaces; ``to_world`` is from the frame of the map."""
    walked, result = recording.walked, Score(planes=len(planes))
    of_surface: dict[int, list[int]] = defaultdict(list)
    for k, plane in enumerate(planes):
        points_m = to_world.points(plane.points(plane.cells.middles_m()))
        off_m = [_off_surface_m(face, points_m, coefficients.normals[k])
                 for face in walked.surfaces + walked.gone]
        best = int(np.argmin(off_m))
        if off_m[best] == np.inf:
            result.of_none += 1
        elif best >= len(walked.surfaces):
            result.left += 1
        else:
            of_surface[best].append(k)
    overlaps, offsets_m, squared = [], [], []
    for surface, cells in recording.regions.items():
        own = of_surface.get(surface, [])
        result.surfaces += 1
        face = walked.surfaces[surface]
        overlap = _overlap(face, cells, [planes[k] for k in own], to_world)
        if overlap[1] > 0.5:
            result.found += 1
            result.pieces += len(own)
        overlaps.append(overlap[0])
        for k in own:
            misfit, deviation, point_off_m = _misfit(face, planes[k], coefficients, k, to_world)
            offsets_m.append(abs(point_off_m))
            squared.append(misfit @ np.linalg.solve(deviation, misfit) / 3)
    return result + Score(overlaps=tuple(overlaps), offsets_m=tuple(offsets_m),
                          squared=tuple(squared))


def _off_surface_m(face: Rectangle, points_m: np.ndarray, normal: np.ndarray) -> float:
    """Return the distance of points from a surface if half of them are on it; otherwise inf."""
    u, v = face.edge_u, face.edge_v
    across = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
    if abs(across @ normal) < SAME_SIDE:
        return np.inf
    along = along_face(face, points_m)
    size = np.array([np.linalg.norm(u), np.linalg.norm(v)])
    is_on = ((abs(along[:, 2]) < NEAR_M) & (along[:, :2] > -CELL_M).all(axis=1)
             & (along[:, :2] < size + CELL_M).all(axis=1))
    return float(abs(along[is_on, 2]).mean()) if is_on.mean() > 0.5 else np.inf


def _overlap(face: Rectangle, cells: np.ndarray, planes: Sequence[MapPlane],
             to_world: RigidTransform) -> tuple[float, float]:
    """Return intersection over union, and the found share, of the observed cells."""
    low, high = cells.min(axis=0) - 8, cells.max(axis=0) + 8
    shape = tuple(high - low + 1)
    truth, found = np.zeros(shape, bool), np.zeros(shape, bool)
    truth[tuple((cells - low).T)] = True
    u, v = (edge / np.linalg.norm(edge) for edge in (face.edge_u, face.edge_v))
    flat_m = CELL_M * (np.indices(shape).reshape(2, -1).T + low + 0.5)
    points_m = to_world.inverse().points(face.corner + flat_m @ np.array([u, v]))
    for plane in planes:
        own = np.floor((points_m - plane.origin_m) @ plane.axes[:2].T / plane.cells.size_m
                       ).astype(int) - plane.cells.low
        inside = ((own >= 0) & (own < plane.cells.hits.shape[::-1])).all(axis=1)
        hit = np.zeros(len(own), bool)
        hit[inside] = plane.cells.seen[own[inside, 1], own[inside, 0]]
        found |= hit.reshape(shape)
    both = np.count_nonzero(truth & found)
    return both / np.count_nonzero(truth | found), both / np.count_nonzero(truth)


def _misfit(face: Rectangle, plane: MapPlane, coefficients: Planes, k: int,
            to_world: RigidTransform) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the error of a plane: coefficients, their covariance, offset at its centre."""
    frames = PlaneFrames(to_world.points(plane.origin_m)[None],
                         (plane.axes @ to_world.rotation.T)[None], np.zeros((1, 3)),
                         np.zeros((1, 3, 3)))
    (heights,), (covariance,), _ = heights_of(frames, coefficients, np.array([k]))
    normal = np.cross(face.edge_u, face.edge_v)
    normal *= np.sign(normal @ coefficients.normals[k]) / np.linalg.norm(normal)
    truth = Planes.of([Plane(normal, -normal @ face.corner, face.corner, 1, 0.0, 1.0,
                             np.zeros((4, 4)), 1.0)])
    (true_heights,), _, _ = heights_of(frames, truth, np.zeros(1, int))
    misfit = heights - true_heights
    return misfit, covariance, float(np.append(plane.cells.centroid_m, 1.0) @ misfit)


@dataclass(frozen=True)
class Case:
    """Rooms, noise and poses of one line of the table."""

    title: str
    rooms: tuple[str, ...]
    noise: float | str
    poses: str
    variant: str = ''


CASES = (
    *(Case(f'box rooms, {poses}', ('box',), 0.001, poses)
      for poses in ('exact', 'drift', 'jitter', 'jump 10', 'jump 30')),
    Case('box rooms, drift, noise .004', ('box',), 0.004, 'drift'),
    *(Case(f'hard rooms, {poses}', HARD, 0.001, poses)
      for poses in ('exact', 'drift', 'jitter', 'jump 10', 'jump 30')),
    Case('hard rooms, drift, noise .004', HARD, 0.004, 'drift'),
    Case('hard rooms, drift, structured light', HARD, 'structured light', 'drift'),
    Case('hard rooms, drift, time of flight', HARD, 'time of flight', 'drift'),
    Case('standing', ('box',), 0.001, 'exact', 'standing'),
    Case('people, drift', ('crate',), 0.001, 'drift', 'people'))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('--walks', type=at_least_one, default=2, help='of each kind of room')
    parser.add_argument('--images', type=at_least_one, default=100, help='of each walk')
    parser.add_argument('--only', default='', help='cases with this in their name')
    add_shared(parser, '--first-seed', '--processes')


HEADER = ('case', 'surfaces', 'found', 'pieces', 'planes', 'of no surface', 'left of what went',
          'IoU', 'offset 95 % (cm)', 'chi-squared / 3: median, mean',
          'switches', 'jumps', 'ms: median, worst')


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    chosen = [case for case in CASES if options.only in case.title]
    seeds = range(options.first_seed, options.first_seed + options.walks)
    jobs: dict[tuple, list[Case]] = defaultdict(list)
    for case in chosen:
        for room in case.rooms:
            for seed in seeds:
                jobs[room, seed, case.noise, case.variant].append(case)
    work = [(key, tuple(cases), options.images) for key, cases in jobs.items()]
    totals: dict[str, Score] = {}
    for scores in in_parallel(_scores, work, options.processes, 'walks'):
        for title, one in scores.items():
            totals[title] = totals.get(title, Score()) + one
    emit(f'{len(seeds)} walks of each kind of room, seeds {seeds[0]} to {seeds[-1]}, '
         f'{options.images} images of {QVGA.width} x {QVGA.height}',
         table(HEADER, [row(case.title, totals[case.title]) for case in chosen]))


def _scores(work: tuple) -> dict[str, Score]:
    (room, seed, noise, variant), cases, images = work
    recording = record(room, seed, noise, images, QVGA, variant)
    return {case.title: score(recording, case.poses, seed) for case in cases}


def row(title: str, total: Score) -> list[str]:
    """Return the cells of a line."""
    return [title, str(total.surfaces), f'{total.found / max(total.surfaces, 1):.1%}',
            f'{total.pieces / max(total.found, 1):.2f}', str(total.planes),
            f'{total.of_none / max(total.planes, 1):.1%}', str(total.left),
            f'{np.median(total.overlaps):.3f}', f'{100 * np.quantile(total.offsets_m, .95):.2f}',
            f'{np.median(total.squared):.2f}, {np.mean(total.squared):.2f}',
            f'{total.switches / max(total.seen, 1):.1%}',
            str(total.jumps), f'{1e3 * np.median(total.seconds):.1f}, '
            f'{1e3 * np.max(total.seconds):.1f}']
