# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Fronts of one camera: planes and classes by colour alone, and the vertical.

Depth comes from fastdepth. The depth measured with the images is the reference: for normals, the
best plane through the points of a detected plane; for the covering, the planes in it; for classes,
the surroundings of each pixel. A network is never evaluated with one seed, because the seed
changes normals by degrees.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

from plane_detector import Config, PlaneDetector, segment_planes
from plane_detector.config import DepthConfig, RansacConfig
from plane_detector.depth.estimator import BLUR_INPUT_PX
from plane_detector.depth.observation import DepthFunction
from plane_detector.evaluation.benchmark import relative
from plane_detector.evaluation.datasets import read_frame
from plane_detector.evaluation.metrics import angle_deg, overlap, segmentation_covering
from plane_detector.evaluation.peers import plane_array
from plane_detector.evaluation.reference_planes import judge_planes
from plane_detector.evaluation.scenes import rooms
from plane_detector.evaluation.scenes.textures import textured
from plane_detector.evaluation.scores.classes import class_shares, classes_of_depth
from plane_detector.evaluation.scores.clips import Shot, clip
from plane_detector.evaluation.scores.measured import seeded
from plane_detector.evaluation.scores.table import HIGHER, LOWER, Draw, Measurement, Values
from plane_detector.types import CameraIntrinsics, Detection, Prediction

# Single images: the set, the step between its images, and their number.
SINGLE = {'living_room': (5, 12), 'kinect_walk': (5, 12), 'kitchen': (1, 8), 'nyu': (1, 3),
          'labelled/nyu_planes_dpd': (1, 8)}
NAMES = {'labelled/nyu_planes_dpd': 'nyu', 'videos/kitchen_30hz': 'kitchen_30hz'}
STREAMS = {'living_room': (1, 30), 'kinect_walk': (1, 30), 'videos/kitchen_30hz': (1, 30)}
SINGLE_SEEDS, STREAM_SEEDS = 8, 4
WRONG_DEG = 6.0
"""An error of the vertical above this makes classes wrong."""
PURE, LEAST_SHARE = 0.9, 0.01
"""Planes with this share of their pixels on one true plane, and of the image, are evaluated."""
WORDS = ('gravity stated', 'nothing stated')


def by_colour(seed: int) -> PlaneDetector:
    """Return a detector with the network, on one thread."""
    return PlaneDetector(Config(depth=DepthConfig(model='fastdepth', threads=1),
                                ransac=RansacConfig(seed=seed)))


@lru_cache(maxsize=128)
def _reference(shot: _Key) -> np.ndarray:
    return segment_planes(shot.shot.depth_m, shot.shot.intrinsics).labels


@dataclass(frozen=True)
class _Key:
    """A shot that is hashed by its place in memory, where the cache of clips holds it."""

    shot: Shot

    def __hash__(self) -> int:
        return id(self.shot)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and self.shot is other.shot


def vertical(found: Detection, down: np.ndarray) -> tuple[bool, bool]:
    """Return whether the image gave the direction of gravity, and whether it is wrong."""
    answer = found.gravity.gravity_camera
    return answer is not None, bool(answer is not None and angle_deg(answer, down) > WRONG_DEG)


def normals_deg(found: Detection, depth_m: np.ndarray, intrinsics: CameraIntrinsics) -> float:
    """Return the mean error of the normals of pure planes; NaN if there is none."""
    large = np.flatnonzero(np.bincount(found.labels[found.labels >= 0], minlength=len(
        found.planes)) >= LEAST_SHARE * found.labels.size)
    index = np.full(len(found.planes) + 1, -1)
    index[large] = np.arange(len(large))
    judged = judge_planes(index[found.labels], plane_array(found)[large], depth_m, intrinsics,
                          np.random.default_rng(0))
    errors = [one.normal_error_deg for one in judged if one.purity >= PURE]
    return float(np.mean(errors)) if errors else float('nan')


def judged(found: Detection, shot: Shot, word: str) -> dict[str, float]:
    """Return the numbers of one image."""
    right, wrong = class_shares(found, classes_of_depth(shot.depth_m, shot.intrinsics, shot.down))
    values = {f'{word}: normals of pure planes (deg)': normals_deg(found, shot.depth_m,
                                                                   shot.intrinsics),
              f'{word}: right classes': right, f'{word}: wrong classes': wrong}
    if word == WORDS[1]:
        answered, is_wrong = vertical(found, shot.down)
        values |= {'SC': segmentation_covering(overlap(
            _reference(_Key(shot)), found.labels, np.isfinite(shot.depth_m)).counts),
            'vertical answered': answered, 'vertical wrong': is_wrong}
    return values


JUDGED = {'SC': HIGHER, 'vertical answered': HIGHER, 'vertical wrong': LOWER, **{
    f'{word}: {what}': better for word in WORDS for what, better in (
        ('normals of pure planes (deg)', LOWER), ('right classes', HIGHER),
        ('wrong classes', LOWER))}}


def gathered(found: Iterable[dict[str, float]], title: str) -> dict[str, list[float]]:
    """Return the numbers of several images by the names of fronts."""
    values: dict[str, list[float]] = defaultdict(list)
    for one in found:
        for name, value in one.items():
            values[f'{title}: {name}'].append(value)
    return values


def single(draw: Draw) -> Values:
    """Return the numbers of images each of which is the first one."""
    detector, found = by_colour(draw.seed), []
    for shot in clip(draw.data, draw.part, *SINGLE[draw.part]):
        for word in WORDS:
            detector.reset()
            found.append(judged(detector.detect(
                shot.rgb, shot.intrinsics, None, shot.down if word == WORDS[0] else None), shot,
                word))
    return gathered(found, f'single, {NAMES.get(draw.part, draw.part)}')


def stream(draw: Draw) -> Values:
    """Return the numbers of images in their order."""
    found = []
    for word in WORDS:
        detector = by_colour(draw.seed)
        for shot in clip(draw.data, draw.part, *STREAMS[draw.part]):
            found.append(judged(detector.detect(
                shot.rgb, shot.intrinsics, None, shot.down if word == WORDS[0] else None,
                stamp_s=shot.stamp_s), shot, word))
    return gathered(found, f'stream, {NAMES.get(draw.part, draw.part)}')


KINDS = ('measured', 'colour')
WALKS = {'living_room': (2, 20), 'kinect_walk': (2, 20)}


def _detect(detector: PlaneDetector, kind: str, shot: Shot, down: np.ndarray | None = None,
            stamp_s: float | None = None) -> Detection:
    return detector.detect(shot.rgb, shot.intrinsics,
                           shot.depth_m if kind == 'measured' else None, down,
                           stamp_s=shot.stamp_s if stamp_s is None else stamp_s)


def _detector(kind: str, seed: int) -> PlaneDetector:
    return PlaneDetector(seeded(seed)) if kind == 'measured' else by_colour(seed)


def turned(draw: Draw) -> Values:
    """Return how often the vertical is wrong with a turned camera, and answered upright."""
    kind, name = draw.part.split(', ')
    values: dict[str, list[float]] = defaultdict(list)
    shots = clip(draw.data, name, *WALKS[name])
    for quarters in range(4):
        detector, alone = _detector(kind, draw.seed), _detector(kind, draw.seed)
        for shot in (one.turned(quarters) for one in shots):
            answered, wrong = vertical(_detect(detector, kind, shot), shot.down)
            if quarters:
                alone.reset()
                values[f'{draw.part}, turned single images: vertical wrong'].append(vertical(
                    _detect(alone, kind, shot), shot.down)[1])
                values[f'{draw.part}, turned walk: vertical wrong'].append(wrong)
            else:
                values[f'{draw.part}, upright walk: vertical answered'].append(answered)
                values[f'{draw.part}, upright walk: vertical wrong'].append(wrong)
    return values


REPEATED = {'living_room': (10, 6), 'kinect_walk': (10, 6), 'kitchen': (1, 8)}
TIMES = 12


def repeated(draw: Draw) -> Values:
    """Return the results for one view that is shown repeatedly."""
    changed, wrong = [], []
    for name, (step, count) in REPEATED.items():
        for k, shot in enumerate(clip(draw.data, name, step, count)):
            shot = shot.turned(k)
            detector = _detector(draw.part, draw.seed)
            answers = [vertical(_detect(detector, draw.part, shot, stamp_s=0.5 * time), shot.down)
                       for time in range(TIMES)]
            if not answers[0][0]:
                changed.append(answers[-1][0])
            wrong.append(answers[-1][1])
    return {f'{draw.part}, one view {TIMES} times: refused ones answered': changed or [0.0],
            f'{draw.part}, one view {TIMES} times: vertical wrong': wrong}


CUT_IMAGES = 8


def cut(draw: Draw) -> Values:
    """Return how often the vertical is wrong after a cut to another place and camera."""
    wrong = []
    walks = [clip(draw.data, name, *WALKS[name])[:CUT_IMAGES] for name in WALKS]
    for before, after in (walks, walks[::-1]):
        detector = _detector(draw.part, draw.seed)
        for k, shot in enumerate((*before, *after)):
            found = _detect(detector, draw.part, shot, stamp_s=k / 3)
            if k >= len(before):
                wrong.append(vertical(found, shot.down)[1])
    return {f'{draw.part}, after a cut: vertical wrong': wrong}


FIELD_FACTORS = (0.75, 1.35)
STREET = 'kitti'


def wrong_lens(draw: Draw) -> Values:
    """Return how often the vertical is wrong if the focal length is; each view is shown six times.

    The street is seen by a level camera, and its field of view stated as 69 degrees, not 81.
    """
    views = []
    for name in ('kinect_walk', 'living_room'):
        for shot in clip(draw.data, name, 12, 5):
            camera = shot.intrinsics
            views += [(replace(shot, intrinsics=replace(
                camera, fx=factor * camera.fx, fy=factor * camera.fy)), 'indoors')
                for factor in FIELD_FACTORS]
    for path in sorted((draw.data / STREET).glob('*_depth.png')):
        frame = read_frame(path)
        views.append((Shot(frame.rgb, frame.depth_m, CameraIntrinsics.from_field_of_view(
            frame.intrinsics.width, frame.intrinsics.height, 69.0), np.array([0.0, 1.0, 0.0]),
            0.0), 'street'))
    values: dict[str, list[float]] = defaultdict(list)
    for shot, place in views:
        detector = _detector('colour', draw.seed)
        answers = [vertical(_detect(detector, 'colour', shot, stamp_s=0.5 * time), shot.down)
                   for time in range(6)]
        values[f'wrong field of view, {place}: vertical wrong'].append(answers[-1][1])
    return values


def sensor_lost(draw: Draw) -> Values:
    """Return how often the vertical is wrong where the sensor of gravity drops out."""
    shots, wrong = clip(draw.data, 'kinect_walk', 1, 40), []
    for start in (0, 12):
        detector = _detector(draw.part, draw.seed)
        for k, shot in enumerate(shots[start:start + 26]):
            is_stated = 6 <= k < 16
            found = _detect(detector, draw.part, shot, shot.down if is_stated else None)
            if k >= 16:
                wrong.append(vertical(found, shot.down)[1])
    return {f'{draw.part}, gravity sensor lost: vertical wrong': wrong}


SHARES = relative.ERROR_SHARES


def as_network(draw: Draw) -> Values:
    """Return answers and errors of true depth made relative, in a rendered room with lines."""
    scene, values = textured(rooms.random_room, draw.seed), {}
    for share in SHARES:
        view = relative.network_view(scene, share, np.random.default_rng([draw.seed, 4]))
        values |= _of_view(view, f'relative disparity, rooms, {share:.1%}')
    return values


def real_as_network(draw: Draw) -> Values:
    """Return the same for real images with measured depth."""
    values: dict[str, list[float]] = defaultdict(list)
    for name in relative.REAL:
        for k, path in enumerate(sorted((draw.data / name).glob('*_depth.png'))):
            for share in SHARES:
                view = relative.network_view(read_frame(path), share,
                                             np.random.default_rng([draw.seed, k]))
                for front, value in _of_view(
                        view, f'relative disparity, Kinect, {share:.1%}').items():
                    values[front].append(value)
    return values


def _of_view(view: relative.View, title: str) -> dict[str, float]:
    is_answered = view.by_image().has_true_angles
    return {f'{title}: angles answered': is_answered,
            f'{title}: normals (deg)':
                relative.published_deg(view) if is_answered else float('nan')}


# Pictures from a handheld, upright camera.
UPRIGHT = ('chess', 'nyu_entry', 'dpt_049259', 'dpt_127660', 'dpt_171190', 'dpt_272566',
           'dpt_367386', 'dpt_506656', 'dpt_517069')
UPRIGHT_DEG = 50.0


def raw_outputs(draw: Draw) -> Values:
    """Return the results for raw outputs of strong networks."""
    values: dict[str, list[float]] = defaultdict(list)
    for path in sorted((draw.data / relative.RAW).glob('*.json')):
        about = json.loads(path.read_text())
        rgb = np.ascontiguousarray(cv2.imread(
            str(path.with_name(f'{path.stem}_rgb.jpg')))[..., ::-1])
        prediction = np.load(path.with_name(f'{path.stem}_pred.npz'))['prediction']
        depth = cv2.resize((prediction * about['factor']).astype(np.float32), rgb.shape[1::-1])
        camera = CameraIntrinsics(*(about[key] for key in (
            'fx', 'fy', 'cx', 'cy', 'width', 'height')))
        found = PlaneDetector(seeded(draw.seed, 'model'), DepthFunction(
            lambda rgb, depth=depth: depth, about['output'], relative.NOISE_SHARE,
            blur_px=BLUR_INPUT_PX * min(rgb.shape[:2]) / about['network_short_side'])
        ).detect(rgb, camera)
        values['raw outputs: share of the image in planes'].append((found.labels >= 0).mean())
        if path.stem in UPRIGHT:
            down = found.gravity.gravity_camera
            values['raw outputs: vertical answered'].append(down is not None)
            values['raw outputs: vertical far from down in the picture'].append(
                down is not None and angle_deg(down, np.array([0.0, 1.0, 0.0])) > UPRIGHT_DEG)
        truth = path.with_name(f'{path.stem}_depth.png')
        if truth.is_file():
            true_mm = cv2.imread(str(truth), cv2.IMREAD_UNCHANGED).astype(np.float32)
            values['raw outputs: normals of pure planes (deg)'].append(normals_deg(
                found, np.where(true_mm > 0, true_mm / 1000, np.nan), camera))
    return values


@dataclass(frozen=True)
class _WithNormals(DepthFunction):
    """A network that also provides normals."""

    normals_camera: np.ndarray | None = None

    def predict(self, rgb: np.ndarray, intrinsics: CameraIntrinsics) -> Prediction:
        return replace(super().predict(rgb, intrinsics), normals_camera=self.normals_camera)


NORMALS_DEG = 4.0
"""Smooth error of a network's normals, as for DSINE and Metric3D on offices."""


def with_normals(draw: Draw) -> Values:
    """Return the errors of planes by metric depth with errors of 5 %, and normals beside it."""
    scene = textured(rooms.random_room, draw.seed)
    rng = np.random.default_rng([draw.seed, 6])
    depth_m = (1 / relative.with_network_errors(1 / scene.depth_m, 0.05, rng)).astype(np.float32)
    normals = np.append(scene.planes[:, :3], [[np.nan] * 3], axis=0)[scene.labels]
    error = cv2.GaussianBlur(rng.standard_normal(normals.shape), (0, 0), 40)
    normals = normals + np.radians(NORMALS_DEG) * error / error.std() / np.sqrt(2)
    normals = (normals / np.linalg.norm(normals, axis=-1, keepdims=True)).astype(np.float32)
    model = _WithNormals(lambda rgb: depth_m, 'metric_depth', relative.NOISE_SHARE, blur_px=4,
                         normals_camera=normals)
    found = PlaneDetector(seeded(0, 'model'), model).detect(scene.rgb, scene.intrinsics)
    return {'normals of a network: planes (deg)': normals_deg(found, scene.depth_m,
                                                              scene.intrinsics),
            'normals of a network: SC': segmentation_covering(overlap(
                scene.labels, found.labels, np.isfinite(scene.depth_m)).counts)}


def _named(titles: Sequence[str], fronts: dict[str, int]) -> dict[str, int]:
    return {f'{title}: {name}': better for title in titles for name, better in fronts.items()}


def _single(name: str, parts: tuple[str, ...]) -> Measurement:
    return Measurement(
        'colour', single, _named([f'single, {name}'], JUDGED), draws=SINGLE_SEEDS, parts=parts,
        needs=('data', 'network'),
        steady=(f'single, {name}: nothing stated: normals of pure planes (deg)',))


MEASUREMENTS = (
    *(_single(name, tuple(one for one in SINGLE if NAMES.get(one, one) == name))
      for name in dict.fromkeys(NAMES.get(one, one) for one in SINGLE)),
    *(Measurement('stream', stream, _named([f'stream, {NAMES.get(name, name)}'], JUDGED),
                  draws=STREAM_SEEDS, parts=(name,), needs=('data', 'network'))
      for name in STREAMS),
    Measurement('relative', as_network, _named(
        [f'relative disparity, rooms, {share:.1%}' for share in SHARES],
        {'angles answered': HIGHER, 'normals (deg)': LOWER}), draws=24),
    Measurement('relative', real_as_network, _named(
        [f'relative disparity, Kinect, {share:.1%}' for share in SHARES],
        {'angles answered': HIGHER, 'normals (deg)': LOWER}), draws=4, needs=('data',)),
    Measurement('relative', raw_outputs, {
        'raw outputs: share of the image in planes': HIGHER,
        'raw outputs: vertical answered': HIGHER,
        'raw outputs: vertical far from down in the picture': LOWER,
        'raw outputs: normals of pure planes (deg)': LOWER}, draws=4, needs=('data',)),
    Measurement('relative', with_normals, {'normals of a network: planes (deg)': LOWER,
                                           'normals of a network: SC': HIGHER}, draws=16),
    *(Measurement('vertical', turned, {
        f'{kind}, {name}, turned walk: vertical wrong': LOWER,
        f'{kind}, {name}, turned single images: vertical wrong': LOWER,
        f'{kind}, {name}, upright walk: vertical answered': HIGHER,
        f'{kind}, {name}, upright walk: vertical wrong': LOWER}, draws=3,
        parts=(f'{kind}, {name}',), needs=needs)
      for kind, needs in (('measured', ('data',)), ('colour', ('data', 'network')))
      for name in WALKS),
    *(Measurement('vertical', function, {f'{kind}, {name}': LOWER for name in names}, draws=3,
                  parts=(kind,), needs=needs)
      for kind, needs in (('measured', ('data',)), ('colour', ('data', 'network')))
      for function, names in (
          (repeated, (f'one view {TIMES} times: refused ones answered',
                      f'one view {TIMES} times: vertical wrong')),
          (cut, ('after a cut: vertical wrong',)),
          (sensor_lost, ('gravity sensor lost: vertical wrong',)))),
    Measurement('vertical', wrong_lens, {
        f'wrong field of view, {place}: vertical wrong': LOWER
        for place in ('indoors', 'street')}, draws=3, needs=('data', 'network')))
