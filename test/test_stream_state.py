# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What a stream keeps from image to image, and that nothing of it outlives a reset."""

from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest

from plane_detector import CameraIntrinsics, Config, PlaneDetector
from plane_detector.config import DepthConfig, DirectionsConfig, ScaleConfig, ShapesConfig
from plane_detector.depth.observation import DepthFunction
from plane_detector.directions import finder
from plane_detector.evaluation.metrics import angle_deg
from plane_detector.evaluation.scenes.rendering import camera_rotation, rectangle, render
from plane_detector.evaluation.scenes.rooms import furnished_room, random_room
from plane_detector.evaluation.scenes.textures import textured
from plane_detector.types import Detection

CAMERA = CameraIntrinsics(262.5, 262.5, 159.5, 119.5, 320, 240)
MEASURED = Config(depth=DepthConfig(source='topic'), shapes=ShapesConfig('all'))
SEEDS = (300, 303, 305)


@cache
def scene(seed):
    return textured(random_room, seed, CAMERA)


@cache
def rolled(roll_deg):
    """Return a furnished room from a camera that is rolled by so much."""
    def make(rng, camera):
        rectangles, rotation, position = furnished_room(rng)
        return render(rectangles, rotation @ camera_rotation(0, 0, 0).T
                      @ camera_rotation(0, 0, roll_deg), position, camera, rng)
    return textured(make, 300, CAMERA)


class Relative:
    """A network of relative disparity, whose unit and shift change from image to image."""

    def __init__(self):
        self.by_image = {scene(seed).rgb.tobytes(): (1 / scene(seed).depth_m + 0.1 * k)
                         / (0.3 + 0.1 * k) for k, seed in enumerate(SEEDS)}

    def __call__(self, rgb):
        return self.by_image[rgb.tobytes()].astype(np.float32)


def relative():
    config = Config(scale=ScaleConfig(camera_height=scene(SEEDS[0]).height_m))
    return PlaneDetector(config, DepthFunction(Relative(), 'relative_disparity'))


def same_scale():
    """Return a network of metric depth, of which still images are averaged."""
    noise = iter(np.random.default_rng(0).normal(1, 0.002, (20, CAMERA.height, CAMERA.width)))
    depths = {scene(seed).rgb.tobytes(): scene(seed).depth_m for seed in SEEDS}
    return PlaneDetector(Config(), lambda rgb: depths[rgb.tobytes()] * next(noise))


def difference(one, other):
    """Return the names of the fields in which two results differ in any bit."""
    def equal(a, b):
        if hasattr(a, '__dataclass_fields__'):
            return all(equal(getattr(a, name), getattr(b, name))
                       for name in a.__dataclass_fields__)
        if isinstance(a, tuple):
            return len(a) == len(b) and all(map(equal, a, b))
        if isinstance(a, (np.ndarray, float)):
            return np.array_equal(a, b, equal_nan=True)
        return type(a) is type(b) and bool(a == b)
    names = [field.name for field in fields(Detection) if field.name != 'stage_seconds']
    return [name for name in names
            if name != 'ground_result' and not equal(getattr(one, name), getattr(other, name))
            ] + [name for name in ('heights_m', 'obstacles', 'drops_m') if not equal(
                getattr(one.ground_result, name), getattr(other.ground_result, name))]


def show(detector, seed, stamp_s):
    depth_m = scene(seed).depth_m if detector.config.depth.source == 'topic' else None
    return detector.detect(scene(seed).rgb, CAMERA, depth_m, stamp_s=stamp_s)


@pytest.mark.parametrize('restart', ['reset', 'jump'])
@pytest.mark.parametrize('make', [lambda: PlaneDetector(MEASURED), relative],
                         ids=['measured', 'relative'])
def test_after_a_reset_an_image_gives_what_a_new_detector_gives(make, restart):
    """Bit for bit: labels, scale, lines, gravity, classes, shapes, ground."""
    expected, detector = show(make(), SEEDS[2], 1.0), make()
    for k, seed in enumerate((*SEEDS[:2], *SEEDS[:2])):
        show(detector, seed, 10.0 + 0.05 * k)
    if restart == 'reset':
        detector.reset()
    found = show(detector, SEEDS[2], 10.3 if restart == 'reset' else 1.0)
    assert difference(found, expected) == []
    # And it goes on as a new one does.
    other = make()
    show(other, SEEDS[2], 1.0)
    stamp_s = 10.35 if restart == 'reset' else 1.05
    assert difference(show(detector, SEEDS[0], stamp_s), show(other, SEEDS[0], 1.05)) == []


@pytest.mark.parametrize('make', [lambda: PlaneDetector(MEASURED), relative],
                         ids=['measured', 'relative'])
def test_without_a_reset_the_images_before_count(make):
    """Otherwise the test above could not fail."""
    detector = make()
    show(detector, SEEDS[0], 10.0)
    assert difference(show(detector, SEEDS[2], 10.05), show(make(), SEEDS[2], 1.0))


def test_images_that_overtook_each_other_are_of_one_stream():
    """A second is the limit: a stamp .6 s back is of the same stream, 1.5 s back is another."""
    by_size = {}
    for back_s in (0.6, 1.5):
        detector = PlaneDetector(MEASURED)
        show(detector, SEEDS[0], 10.0)
        labels = show(detector, SEEDS[1], 10.0 - back_s).planes.labels
        by_size[back_s] = labels.tolist() == list(range(1, len(labels) + 1))
    assert by_size == {0.6: False, 1.5: True}


def test_the_second_image_of_a_still_scene_is_averaged_already():
    """In 1/z, with equal weights."""
    rng, inverse = np.random.default_rng(0), 1 / scene(SEEDS[0]).depth_m
    given = (inverse * rng.normal(1, 0.002, (3, *inverse.shape))).astype(np.float32)
    depths = iter(1 / given)
    detector = PlaneDetector(Config(), lambda rgb: next(depths))
    found = [1 / detector.detect(scene(SEEDS[0]).rgb, CAMERA, stamp_s=0.1 * k).depth_m
             for k in range(3)]
    for k in range(3):
        off = np.abs(found[k] / given[:k + 1].mean(axis=0) - 1)
        assert np.nanquantile(off, 0.9) < 1e-4, f'image {k + 1}'


@pytest.mark.parametrize('is_measured', [True, False])
def test_lines_are_sought_often_while_their_planes_are_not_trusted(is_measured, monkeypatch):
    """A sensor in the dark before two slopes shows no vertical; a network may miss a turn."""
    roof = [rectangle((-9, -9 * side, 2.0), (18, 0, 0), (0, 9 * side, 9)) for side in (-1, 1)]
    seen = render(roof, np.eye(3), np.zeros(3), CAMERA, np.random.default_rng(0))
    rgb = np.zeros_like(seen.rgb) if is_measured else scene(SEEDS[0]).rgb
    searches, find = [], finder.find_in_image
    monkeypatch.setattr(finder, 'find_in_image',
                        lambda *given: searches.append(1) or find(*given))
    by_network = Config(directions=DirectionsConfig(mounting='upright'))
    detector = PlaneDetector(MEASURED if is_measured else by_network, None if is_measured
                             else lambda image: seen.depth_m)
    for k in range(30):
        found = detector.detect(rgb, CAMERA, seen.depth_m if is_measured else None,
                                stamp_s=0.2 * k)
    assert len(found.planes) == 2
    assert (found.gravity.gravity_camera is None) == is_measured
    assert len(searches) >= 15, 'held for no more than one image'


def test_the_vertical_turns_with_the_camera_however_long_it_stood():
    """Two seconds still, then a roll by 2 degrees an image."""
    detector, worst_deg = PlaneDetector(MEASURED), 0.0
    for k in range(36):
        now = rolled(2.0 * max(k - 29, 0))
        found = detector.detect(now.rgb, CAMERA, now.depth_m, stamp_s=0.1 * k)
        down = found.gravity.gravity_camera
        if down is not None:
            worst_deg = max(worst_deg, angle_deg(down, now.gravity_camera))
    assert down is not None
    assert worst_deg < 3.5, 'at most one image behind'


def test_a_frame_of_another_size_starts_the_labels_anew():
    half = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)
    small = random_room(np.random.default_rng(SEEDS[1]), half)
    detector = PlaneDetector(replace(MEASURED, shapes=ShapesConfig()))
    show(detector, SEEDS[0], 1.0)
    labels = detector.detect(small.rgb, half, small.depth_m, stamp_s=1.1).planes.labels
    assert labels.tolist() == list(range(1, len(labels) + 1))
