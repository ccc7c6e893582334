# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of the directions of consecutive images."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from plane_detector.config import Config, DirectionsConfig
from plane_detector.directions import finder
from plane_detector.directions.finder import CameraImage, DirectionFinder, find_in_image
from plane_detector.directions.prior import Expected
from plane_detector.directions.surfaces import log_odds_down, sides_of, usual_inverse_depth
from plane_detector.directions.vanishing import SceneDirections
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rooms import attic, corridor, random_room
from plane_detector.evaluation.scenes.textures import rolled_room, room_from_above, textured
from plane_detector.types import CameraIntrinsics, Plane, Planes, PlaneSegmentation

IMAGES, GREY_LEVELS = 12, 5.0
FLICKER_DEG = 0.5
CAMERA = CameraIntrinsics.from_field_of_view(640, 480, 60.0)


@pytest.mark.parametrize(('make', 'seed'), [
    (random_room, 300), (rolled_room, 303)])
def test_the_upright_of_a_still_camera_does_not_flicker(make, seed):
    scene, finder = textured(make, seed), DirectionFinder()
    rng = np.random.default_rng(0)
    found = []
    for _ in range(IMAGES):
        noise = rng.normal(0, GREY_LEVELS, scene.rgb.shape)
        rgb = np.clip(scene.rgb + noise, 0, 255).astype(np.uint8)
        around = finder.find(CameraImage(rgb, scene.intrinsics), None, Config(),
                             for_planes=True)
        found.append(around.gravity.gravity_camera)
    cosine = np.array(found) @ np.array(found).T
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < FLICKER_DEG


def test_axes_are_gravity_and_both_directions_of_each_pair():
    pairs = np.arange(12.0).reshape(2, 2, 3)
    found = finder.ImageDirections(None, SceneDirections(np.ones(3), np.eye(3), pairs))
    np.testing.assert_array_equal(found.axes, [np.ones(3), *pairs[0]])
    np.testing.assert_array_equal(found.all_axes, [np.ones(3), *pairs[0], *pairs[1]])
    nothing = finder.ImageDirections(None, SceneDirections(None, np.eye(3), pairs[:0]))
    assert nothing.axes.shape == nothing.all_axes.shape == (0, 3)


@pytest.mark.parametrize('seed', [303, 304, 313])
def test_the_slopes_of_a_roof_do_not_outvote_floor_and_gable(seed):
    scene = textured(attic, seed)
    image = CameraImage(scene.rgb, scene.intrinsics, disparity=1 / scene.depth_m,
                        is_measured=True)
    found = find_in_image(image, Expected(np.array([0.0, 1.0, 0.0]), 6.0)).directions
    assert found.gravity_camera @ scene.gravity_camera > np.cos(np.radians(1.0))


@pytest.mark.parametrize('seed', [307, 310])
def test_the_ridge_of_a_roof_is_not_surely_the_vertical(seed):
    """Two slopes and a gable look like two walls and a floor from above."""
    scene = textured(attic, seed)
    image = CameraImage(scene.rgb, scene.intrinsics, disparity=1 / scene.depth_m,
                        is_measured=True)
    assert find_in_image(image).directions.probability < 0.92  # was .94 and 1.00


def mounted(scene, turns):
    """Return image and gravity of a camera that is turned by so many times 90 degrees."""
    camera, gravity = scene.intrinsics, scene.gravity_camera
    rgb, disparity = (np.ascontiguousarray(np.rot90(part, turns)) for part in (
        scene.rgb, (1 / scene.depth_m).astype(np.float32)))
    for _ in range(turns):
        camera = CameraIntrinsics(camera.fy, camera.fx, camera.cy, camera.width - 1 - camera.cx,
                                  camera.height, camera.width)
        gravity = np.array([gravity[1], -gravity[0], gravity[2]])
    return CameraImage(rgb, camera, disparity=disparity, is_measured=True), gravity


@pytest.mark.parametrize(('make', 'seeds', 'least', 'most_wrong'), [
    (random_room, range(303, 308), 4, 0), (corridor, range(8006, 8010), 0, 1)])
def test_hardly_a_vertical_is_wrong_because_nobody_stated_the_mounting(
        make, seeds, least, most_wrong):
    """A corridor on its side, seen from near a wall, looks like one seen from near the floor."""
    upright = wrong = 0
    for seed in seeds:
        scene = textured(make, seed)
        for turns in range(4):
            image, gravity = mounted(scene, turns)
            down = find_in_image(image).directions.gravity_camera
            upright += down is not None and turns == 0
            wrong += down is not None and down @ gravity < np.cos(np.radians(5))
    assert upright >= least
    assert wrong <= most_wrong


@pytest.mark.parametrize('turns', [1, 2, 3])
def test_a_stated_mounting_gives_the_vertical_of_a_turned_camera(turns):
    image, gravity = mounted(textured(corridor, 8000), turns)
    found = find_in_image(image, Expected(gravity)).directions
    assert found.gravity_camera @ gravity > np.cos(np.radians(1))


def test_the_same_image_again_is_not_surer_than_alone():
    """Along a corridor nothing tells the mounting."""
    image, _ = mounted(textured(corridor, 8006), 0)
    alone = found = find_in_image(image)
    assert alone.directions.gravity_camera is None
    for _ in range(12):
        found = find_in_image(image, before=found)
        assert found.directions.gravity_camera is None
        assert found.directions.probability < alone.directions.probability + 0.02


@pytest.mark.parametrize('turns', [0, 2])
@pytest.mark.parametrize('is_measured', [False, True])
def test_after_a_cut_an_image_is_judged_alone(turns, is_measured):
    first, second = (replace(mounted(textured(random_room, seed), turn)[0],
                             is_measured=is_measured) for seed, turn in ((303, 0), (305, turns)))
    alone = find_in_image(second).directions
    after = find_in_image(second, before=find_in_image(first)).directions
    assert after.probability == pytest.approx(alone.probability, abs=1e-9)
    assert (after.gravity_camera is None) == (alone.gravity_camera is None)


@pytest.mark.parametrize('turns', [1, 2, 3])
def test_a_network_alone_does_not_tell_the_side_that_is_below(turns):
    """Networks find a floor at the bottom of the image, whatever is there."""
    scene = textured(random_room, 303)
    image, gravity = mounted(scene, turns)
    upright = mounted(scene, 0)[0].disparity
    shown = upright if turns == 2 else cv2.resize(upright, image.disparity.shape[::-1])
    image = replace(image, disparity=shown, is_measured=False)
    found = None
    for _ in range(4):
        found = find_in_image(image, before=found)
        down = found.directions.gravity_camera
        assert down is None or down @ gravity > np.cos(np.radians(5))


def test_who_knows_that_the_camera_is_upright_gets_the_vertical():
    image, gravity = mounted(textured(corridor, 8006), 0)
    down = find_in_image(image, mounting='upright').directions.gravity_camera
    assert down @ gravity > np.cos(np.radians(1))


def test_a_guessed_lens_gives_a_direction_with_a_larger_error():
    scene = textured(random_room, 303)
    image, gravity = mounted(scene, 0)
    known, guessed = (find_in_image(replace(image, is_lens_guessed=guess)).directions
                      for guess in (False, True))
    assert guessed.probability <= known.probability + 0.01
    tilt = np.arcsin(abs(gravity[2]))
    wrong_rad = 0.15 * np.sin(tilt) * np.cos(tilt)
    if guessed.gravity_camera is not None:
        added = np.trace(guessed.covariance) - np.trace(known.covariance)
        assert added > 0.5 * wrong_rad**2


def test_lines_from_before_an_imu_are_not_used_after_it(monkeypatch):
    times, finder = [], DirectionFinder()
    nothing = SimpleNamespace(directions=SimpleNamespace(gravity_camera=None, refusal=''))
    monkeypatch.setattr('plane_detector.directions.finder.find_in_image',
                        lambda image, *_: times.append(image.stamp_s) or nothing)
    walls = Planes.of([Plane(normal, 2.0, -2.0 * normal, 5000, 0.0, 1.0, np.eye(4), 1.0,
                             label=k + 1) for k, normal in enumerate(-np.eye(3)[[2, 0]])])
    config = Config(directions=DirectionsConfig(hold_time=0.5))
    for step in range(12):
        down = np.array([0.0, 1.0, 0.0]) if 2 <= step < 10 else None
        finder.find(CameraImage(None, CAMERA, stamp_s=1 + step / 10, is_still=True), down, config)
        finder.note_planes(PlaneSegmentation(walls, np.zeros((100, 100), np.int32), 0.0), True)
    assert times == [1.0, 2.0]


def test_depth_without_a_surface_leaves_the_mounting_open():
    scene = textured(random_room, 300)
    for turns in range(4):
        image, gravity = mounted(scene, turns)
        image = replace(image, disparity=np.full_like(image.disparity, np.nan), is_measured=False)
        down = find_in_image(image).directions.gravity_camera
        assert down is None or down @ gravity > np.cos(np.radians(5))


def test_gravity_points_to_what_faces_upwards():
    floor, wall = np.tile([0.0, 1.0, 0.0], (40, 1)), np.tile([1.0, 0.0, 0.0], (20, 1))
    seen = sides_of(np.vstack([floor, wall, -wall])).log_likelihood
    assert (seen[0], seen.argmin()) == (0, 2) and seen[1] == pytest.approx(seen[3])
    assert sides_of(-floor).log_likelihood.argmax() == 2
    tube = sides_of(np.vstack([floor, -floor, wall, -wall])).log_likelihood
    assert tube == pytest.approx(np.zeros(4), abs=1)
    assert sides_of(floor[:0]).log_likelihood.tolist() == [0] * 4


def tiles(roll_deg):
    """Return a tiled surface parallel to the image plane, (480, 640, 3) uint8."""
    v, u = np.mgrid[:480, :640]
    angle = np.radians(roll_deg)
    x, y = np.cos(angle) * u + np.sin(angle) * v, np.cos(angle) * v - np.sin(angle) * u
    grey = ((x // 80 + y // 80) % 2 * 90 + 80).astype(np.uint8)
    return np.repeat(cv2.GaussianBlur(grey, (5, 5), 1)[..., None], 3, axis=2)


@pytest.mark.parametrize('has_depth', [False, True])
@pytest.mark.parametrize('roll_deg', [0, 5, 15])
def test_a_table_from_above_is_not_surely_a_wall(roll_deg, has_depth):
    disparity = np.full((480, 640), 1.25, np.float32) if has_depth else None
    found = find_in_image(CameraImage(tiles(roll_deg), CAMERA, disparity=disparity)).directions
    assert found.gravity_camera is None or found.gravity_camera[2] > np.cos(np.radians(5))
    assert (found.modes.downs[:, 2] > np.cos(np.radians(5))).any()


def test_a_camera_that_looks_straight_down_is_found_at_any_azimuth():
    below = np.full((480, 640), 1.25, np.float32)
    found = find_in_image(CameraImage(tiles(45), CAMERA, disparity=below)).directions
    assert found.gravity_camera[2] > np.cos(np.radians(5))
    wrong = right = 0
    for seed in range(300, 308):
        scene = textured(room_from_above, seed)
        image = CameraImage(scene.rgb, scene.intrinsics, disparity=1 / scene.depth_m,
                        is_measured=True)
        down = find_in_image(image).directions.gravity_camera
        if down is not None:
            is_right = down @ scene.gravity_camera > np.cos(np.radians(5))
            right, wrong = right + is_right, wrong + (not is_right)
    assert (right >= 4, wrong) == (True, 0)


@pytest.mark.parametrize(('seed', 'noise_per_m', 'has_shift'), [
    (315, 0.0, False), (318, 0.0, False), (310, 0.008, False), (315, 0.0, True),
    (328, 0.0, True)])
def test_a_floor_that_fills_the_image_is_not_surely_a_wall(seed, noise_per_m, has_shift):
    """Furniture lets the disparity grow downwards by chance."""
    scene = textured(room_from_above, seed)
    depth_m = with_disparity_noise(scene.depth_m, noise_per_m, np.random.default_rng([seed, 2]))
    image = CameraImage(scene.rgb, scene.intrinsics, disparity=(1 / depth_m).astype(np.float32),
                        has_shift=has_shift)
    down = find_in_image(image).directions.gravity_camera
    assert down is None or down @ scene.gravity_camera > np.cos(np.radians(5))


def test_a_surface_ahead_is_evidence_for_looking_down_and_its_absence_is_none():
    disparity = np.ones((48, 64), np.float32)
    ahead, aside = np.tile([0.0, 0.0, 1.0], (9, 1)), np.tile([1.0, 0.0, 0.0], (9, 1))
    assert log_odds_down(disparity, ahead) > 1
    assert log_odds_down(disparity, aside[:0]) == 0
    assert log_odds_down(disparity, aside) == pytest.approx(0, abs=1e-9)


def test_what_is_near_at_the_bottom_is_evidence_against_looking_down():
    nearer = np.tile(np.linspace(0.2, 1.0, 480)[:, None], (1, 640))
    assert log_odds_down(nearer, np.zeros((0, 3))) < -0.3
    assert log_odds_down(nearer[::-1], np.zeros((0, 3))) > 1.8


def test_a_usual_shift_makes_the_near_tenth_twice_as_near_as_the_far_one():
    inverse = usual_inverse_depth(np.tile(np.linspace(-3.0, 5.0, 480)[:, None], (1, 640)))
    assert np.quantile(inverse, 0.1) / np.quantile(inverse, 0.9) == pytest.approx(0.43, abs=0.02)


def test_normals_at_a_guessed_shift_are_no_evidence(monkeypatch):
    given, collect = [], finder.collect_evidence
    monkeypatch.setattr(finder, 'collect_evidence', lambda segments, surface, *by_depth, **lens: (
        given.append(surface), collect(segments, surface, *by_depth, **lens))[1])
    disparity = np.tile(np.linspace(0.2, 0.6, 480, dtype=np.float32)[:, None], (1, 640))
    for has_shift in (False, True):
        find_in_image(CameraImage(tiles(5), CAMERA, disparity=disparity, has_shift=has_shift))
    assert given[0] is not None and given[1] is None


def test_a_wall_ahead_with_a_floor_is_still_a_wall():
    scene = textured(random_room, 2007)  # most of it is within ten degrees of the image plane
    image = CameraImage(scene.rgb, scene.intrinsics, disparity=1 / scene.depth_m,
                        is_measured=True)
    found = find_in_image(image).directions
    assert found.modes.downs[0] @ scene.gravity_camera > np.cos(np.radians(2))


def search_times(monkeypatch, turn_deg=0.0, is_still=True, is_trusted=True, hold_time=0.1,
                 walls=2, nearer_by=1.0):
    """Return when lines are sought, of images every quarter second while the camera turns."""
    times, finder = [], DirectionFinder()
    config = Config(directions=DirectionsConfig(hold_time=hold_time))
    nothing = SimpleNamespace(directions=SimpleNamespace(gravity_camera=None, refusal=''))
    monkeypatch.setattr('plane_detector.directions.finder.find_in_image',
                        lambda image, *_: times.append(image.stamp_s) or nothing)
    for step in range(32):
        turn = cv2.Rodrigues(np.radians([0.0, step * turn_deg, 0.0]))[0]
        planes = Planes.of([Plane(turn @ normal, 2.0, -2.0 * turn @ normal, 5000, 0.0, 1.0,
                                  np.eye(4), 1.0, label=k + 1)
                            for k, normal in enumerate(-np.eye(3)[[2, 0]][:walls])])
        image = CameraImage(None, CAMERA, disparity=np.full((480, 640), 0.5 * nearer_by**step),
                            stamp_s=1 + step / 4, is_still=is_still)
        finder.find(image, None, config, for_planes=True)
        finder.note_planes(PlaneSegmentation(planes, np.zeros((100, 100), np.int32), 0.0),
                           is_trusted)
    return times


@pytest.mark.parametrize(('hold_time', 'expected'), [
    (0.1, [1.0, 1.5, 2.5, 4.5, 6.5, 8.5]), (0.2, [1.0, 2.0, 4.0, 8.0])])
def test_lines_are_held_ever_longer_while_planes_show_no_turn(monkeypatch, hold_time, expected):
    assert search_times(monkeypatch, hold_time=hold_time) == expected


@pytest.mark.parametrize('moves', [{'turn_deg': 1.0}, {'is_still': False}, {'is_trusted': False},
                                   {'walls': 1}])
def test_lines_are_hardly_held_while_something_may_move(monkeypatch, moves):
    assert len(search_times(monkeypatch, **moves)) >= 16, 'held for no more than one image'


@pytest.mark.parametrize(('nearer_by', 'is_held'), [(1.01, True), (1.06, False), (0.93, False)])
def test_lines_are_not_held_after_a_jump_of_the_depth(monkeypatch, nearer_by, is_held):
    """The planes of an image show only for the next one that the camera has turned."""
    assert len(search_times(monkeypatch, nearer_by=nearer_by)) == (6 if is_held else 32)


@pytest.mark.parametrize('down', np.eye(3))
def test_a_measured_vertical_is_an_axis_of_an_image_without_lines(down):
    image = CameraImage(np.full((480, 640, 3), 90, np.uint8), CAMERA)
    assert not len(find_in_image(image, Expected(down, np.radians(1.0))).axes)
    around = DirectionFinder().find(image, down, Config(), for_planes=True)
    assert around.lines.axes == pytest.approx(down[None])
