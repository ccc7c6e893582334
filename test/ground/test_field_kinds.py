# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What real robots send, of each kind some variants: right, or the note says why not."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from plane_detector import Config, PlaneDetector
from plane_detector.config import DepthConfig, GroundConfig, ScaleConfig
from plane_detector.evaluation.scenes.rendering import rectangle
from plane_detector.evaluation.scenes.terrain import Course, Kind, View, look, noisy
from plane_detector.geometry.projection import pixel_rays
from plane_detector.ground.ground import find_ground
from plane_detector.ground.obstacles import without_box
from plane_detector.planes.classification import PlaneClass
from plane_detector.types import CameraIntrinsics, Gravity, PlaneSegmentation


def course(edge_m=4.0, lower_m=0.0, half_width_m=2.2, boxes=(), ceiling_m=None):
    """Return a hall whose floor ends at an edge; boxes are x, y, size, height of their foot."""
    way = Course(half_width_m)
    way.on(edge_m, 0.0, Kind.FLOOR)
    if lower_m:
        way.on(edge_m, -lower_m, Kind.OBSTACLE)
        way.on(9.0, -lower_m, Kind.LOWER)
    end_m, w = (9.0 if lower_m else edge_m), half_width_m
    way.add([rectangle([-w, end_m, -3], [2 * w, 0, 0], [0, 0, 6]),
             *(rectangle([x, -3, -3], [0, end_m + 3, 0], [0, 0, 6]) for x in (-w, w))],
            Kind.OBSTACLE)
    if ceiling_m:
        way.add([rectangle([-w, -3, ceiling_m], [2 * w, 0, 0], [0, end_m + 3, 0])], Kind.OBSTACLE)
    for x, y, size, *foot in boxes:
        way.add_box(x, y, np.array(size), *foot)
    return way


def seen(way, height_m, pitch_deg, roll_deg=0.0, yaw_deg=0.0, is_half=False, noise=0.0):
    """Return what a camera sees: depth, kinds, points in the world, camera, direction down."""
    view = look(way, View(height_m, pitch_deg, roll_deg, yaw_deg), np.random.default_rng(3))
    scene, step = view.scene, 2 if is_half else 1
    lens = scene.intrinsics
    if is_half:
        lens = CameraIntrinsics(lens.fx / 2, lens.fy / 2, lens.cx / 2, lens.cy / 2,
                                lens.width // 2, lens.height // 2)
    depth_m = noisy(view, noise, np.random.default_rng(1))[::step, ::step].copy()
    return SimpleNamespace(depth_m=depth_m, kinds=view.kinds[::step, ::step], lens=lens,
                           points_m=view.points_m[::step, ::step], down=scene.gravity_camera,
                           above_m=view.above_m[::step, ::step], in_world=view.in_world)


def detect(view, depth_m=None, height_m=0.0, down=None, **settings):
    depth_m = view.depth_m if depth_m is None else depth_m
    return see(detector(height_m, **settings), view, depth_m, down)


def detector(height_m=0.0, max_range=0.0, **settings):
    return PlaneDetector(Config(depth=DepthConfig(source='topic', max_range=max_range),
                                scale=ScaleConfig(camera_height=height_m),
                                ground=GroundConfig(**settings)))


def see(one, view, depth_m, down=None):
    """Return what a detector finds in the next image."""
    return one.detect(np.full((*depth_m.shape, 3), 90, np.uint8), view.lens,
                      depth_m.astype(np.float32), view.down if down is None else down)


# 1. Obstacles need no plane.
@pytest.mark.parametrize('height_m', [0.0, 0.6])
@pytest.mark.parametrize('radius_m, ahead_m, is_half', [(0.15, 0.5, False), (0.3, 1.2, True),
                                                         (0.08, 0.7, False)])
def test_a_round_thing_alone_is_an_obstacle_and_drops_are_silent(radius_m, ahead_m, is_half,
                                                                 height_m):
    view = seen(course(), 0.6, 0.0, is_half=is_half)
    v, u = np.indices(view.depth_m.shape)
    x, y = (u - view.lens.cx) / view.lens.fx, (v - view.lens.cy) / view.lens.fy
    rays = x * x + y * y + 1
    inside = ahead_m**2 - rays * (ahead_m**2 - radius_m**2)
    ball_m = np.where(inside > 0, (ahead_m - np.sqrt(np.maximum(inside, 0))) / rays, np.nan)
    found = detect(view, ball_m, height_m)
    assert found.ground_result.is_known and len(found.drops_m) == 0
    assert found.obstacles.sum() > 0.98 * np.isfinite(ball_m).sum()
    # A ball alone shows no noise and may be one flat piece: then the floor is uncertain.
    assert 'seen' in found.ground_result.drop_note or 'may be' in found.ground_result.drop_note
    heights_m = found.ground_result.heights_m[np.isfinite(ball_m)]
    assert np.isnan(heights_m).all() if not height_m else abs(heights_m.mean() - 0.6) < 0.05


# 2. Down is where gravity says.
@pytest.mark.parametrize('height_m, pitch_deg, edge_m, lower_m, roll_deg', [
    (1.0, 25, 1.8, 0.6, 90), (1.0, 25, 1.8, 0.6, 180), (0.5, 15, 1.2, 0.15, 270),
    (1.0, 20, 1.6, 0.3, 50), (1.5, 60, 0.8, 0.3, 135), (1.5, 90, 0.3, 0.5, 0),
    (2.0, 75, 0.5, 0.2, 200)])
def test_drops_are_found_however_the_camera_is_turned(height_m, pitch_deg, edge_m, lower_m,
                                                     roll_deg):
    view = seen(course(edge_m, lower_m, 3.0), height_m, pitch_deg, roll_deg, noise=0.002)
    found = detect(view)
    is_floor = view.kinds == Kind.FLOOR
    assert found.ground[is_floor].mean() > 0.98 and found.obstacles[is_floor].mean() < 0.005
    assert found.camera_height_m == pytest.approx(height_m, abs=0.02)
    drops_m = view.in_world(found.drops_m)
    assert abs(drops_m[:, 1] - edge_m).max() < 0.05
    edge = view.points_m[is_floor & (abs(view.points_m[..., 1] - edge_m) < 0.03)]
    assert np.ptp(drops_m[:, 0]) > 0.85 * np.ptp(edge[:, 0])
    assert np.median(found.ground_result.drop_depths_m) == pytest.approx(lower_m, abs=0.02)


# 4. Range is no edge.
@pytest.mark.parametrize('limit_m, is_range, height_m, pitch_deg, roll_deg, noise', [
    (2.0, False, 0.6, 20, 0, 0.0), (1.5, False, 0.3, 12, 4, 0.001), (3.0, True, 1.0, 25, 90, 0.0),
    (2.5, True, 0.6, 15, -3, 0.002)])
def test_the_range_of_a_sensor_is_no_edge(limit_m, is_range, height_m, pitch_deg, roll_deg,
                                          noise):
    way = course(8.0, boxes=[(0.4, 1.3, (0.2, 0.2, 0.15))])
    view = seen(way, height_m, pitch_deg, roll_deg, noise=noise)
    v, u = np.indices(view.depth_m.shape)
    x, y = (u - view.lens.cx) / view.lens.fx, (v - view.lens.cy) / view.lens.fy
    far_m = view.depth_m * (np.sqrt(x * x + y * y + 1) if is_range else 1)
    depth_m = np.where(far_m > limit_m, np.nan, view.depth_m)
    detectors = detector(), detector(max_range=limit_m)
    for _ in range(3):
        unknown, stated = (see(one, view, depth_m) for one in detectors)
        assert len(unknown.drops_m) == 0 and 'depth.max_range' in unknown.ground_result.drop_note
        assert len(stated.drops_m) == 0
        assert not stated.ground_result.drop_note and not stated.ground_result.edge_note


def with_noise(view, kind, rng):
    """Return depth as a sensor of a kind measures it."""
    z = view.depth_m
    if kind == 'stereo':
        return 1 / (1 / z + rng.normal(0, 0.003, z.shape))
    if kind == 'time of flight':
        return z + rng.normal(0, 0.002 + 0.001 * z * z)
    step = 0.125 / (580 * 0.075)  # structured light
    return 1 / (np.round((1 / z + rng.normal(0, 0.0008, z.shape)) / step) * step)


BRINKS = [  # sensor, height, pitch, roll, yaw, edge, range, lower level
    (sensor, height_m, *pose, edge_m, most_m, lower_m) for sensor, views in (
        ('stereo', ((0.1, (0, 0, 0), 1.3, 3.0, 0.7), (0.1, (12, 0, 0), 0.8, 2.0, 0.7),
                    (0.28, (0, 0, 0), 1.6, 7.0, 2.0), (0.28, (10, 180, 20), 1.2, 5.0, 0.3),
                    (0.5, (15, 90, 0), 1.4, 4.0, 1.5), (0.8, (25, 0, -30), 1.5, 6.0, 0.15),
                    (1.2, (40, 0, 0), 1.3, 8.0, 1.0), (1.5, (30, 0, 10), 2.0, 4.5, 0.5))),
        ('time of flight', ((0.1, (5, 0, 0), 1.0, 2.5, 0.4), (0.15, (0, 0, 5), 1.7, 4.0, 1.0),
                            (0.28, (20, 90, 0), 1.1, 3.0, 0.17), (0.35, (8, 0, 0), 2.1, 6.0, 3.0),
                            (0.6, (18, 0, -15), 1.5, 5.0, 1.2), (0.9, (35, 180, 0), 1.2, 3.5, 0.6),
                            (1.2, (22, 0, 0), 2.4, 8.0, 2.5), (1.5, (40, 0, 30), 1.6, 7.0, 0.2))),
        ('structured light', ((0.12, (0, 0, 0), 1.2, 4.0, 0.8), (0.2, (15, 0, 0), 0.9, 2.2, 0.4),
                              (0.28, (5, 0, -10), 1.6, 6.0, 2.0), (0.4, (25, 0, 0), 1.1, 3.0, 1.0),
                              (0.7, (12, 90, 0), 2.2, 7.0, 2.0), (1.0, (30, 0, 25), 1.4, 5.0, 0.3),
                              (1.3, (38, 0, 0), 1.5, 8.0, 0.15), (1.5, (20, 180, 0), 2.5, 4.0, 4.0)
                              ))) for height_m, pose, edge_m, most_m, lower_m in views]


@pytest.mark.parametrize('sensor, height_m, pitch_deg, roll_deg, yaw_deg, edge_m, most_m, lower_m',
                         BRINKS)
def test_an_edge_with_nothing_behind_is_a_drop_or_unknown(sensor, height_m, pitch_deg, roll_deg,
                                                          yaw_deg, edge_m, most_m, lower_m):
    """Known if the sensor has seen farther than the edge before, or is stated to."""
    brink = Course(12.0)
    brink.on(edge_m, 0.0, Kind.FLOOR)
    brink.on(edge_m, -lower_m, Kind.OBSTACLE)
    brink.on(12.0, -lower_m, Kind.LOWER)
    rng, pose = np.random.default_rng(4), (height_m, pitch_deg, roll_deg, yaw_deg)
    view, before = seen(brink, *pose), seen(course(edge_m + 0.8, half_width_m=12.0), *pose)

    def ask(one, of):
        depth_m = with_noise(of, sensor, rng)
        return see(one, of, np.where(depth_m > most_m, np.nan, depth_m))

    stream = detector()
    single = ask(stream, view)
    ask(stream, before)
    answers = single, ask(stream, view), ask(detector(max_range=most_m), view)
    floor_m = view.points_m[(view.kinds == Kind.FLOOR) & (view.points_m[..., 1] > edge_m - 0.06)]
    near = np.linalg.norm(floor_m[:, :2], axis=1) < 2.8  # drops are told up to 3 m
    left, right = np.percentile(floor_m[near, 0], [1, 99])
    for found in answers:
        drops_m = view.in_world(found.drops_m)
        assert (abs(drops_m[:, 1] - edge_m) < 0.2).all()
        if found is not single or not found.ground_result.drop_note:
            counts = np.histogram(drops_m[:, 0], bins=15, range=(left, right))[0]
            assert (counts > 0).mean() > 0.85 and not found.ground_result.drop_note
    # A reset forgets what was seen, and so does another camera.
    stream.reset()
    assert ask(stream, view).ground_result.drop_note == single.ground_result.drop_note


@pytest.mark.parametrize('roll_deg', [0, 90, 180])
def test_a_border_without_depth_is_no_edge(roll_deg):
    view = seen(course(4.0), 1.2, 18, roll_deg, noise=0.001)
    depth_m = np.full_like(view.depth_m, np.nan)
    depth_m[30:-30, 40:-40] = view.depth_m[30:-30, 40:-40]
    assert len(detect(view, depth_m).drops_m) == 0


# 5. Ignorance is not "no drop".
UNIT = 'check the unit'
UNSEEN = {
    'blind': (lambda d: np.full_like(d, np.nan), 0.6, 'nothing is seen'),
    'zeros': (lambda d: 0 * d, 0.6, 'nothing is seen'),
    'beyond max_depth': (lambda d: d + 90, 0.0, 'nothing is seen'),
    'ten times': (lambda d: 10 * d, 0.6, UNIT),
    'a third': (lambda d: d / 3, 0.6, UNIT),
    'inches': (lambda d: d / 0.0254, 0.6, UNIT),
    'millimetres as metres': (lambda d: 1000 * d, 0.6, 'nothing is seen')}


@pytest.mark.parametrize('name', UNSEEN)
def test_drops_are_silent_where_nothing_or_nonsense_is_seen(name):
    change, height_m, note = UNSEEN[name]
    view = seen(course(boxes=[(0.3, 2.0, (0.3, 0.3, 0.4))]), 0.6, 20)
    found = detect(view, change(view.depth_m), height_m)
    assert note in found.ground_result.drop_note and len(found.drops_m) == 0
    assert found.ground_result.is_known == ('nothing is seen' not in note)


@pytest.mark.parametrize('factor', [0.1, 5, 10, 20, 30])
@pytest.mark.parametrize('height_m, pitch_deg, roll_deg, is_half', [
    (0.7, 10, 0, False), (0.7, 20, 0, True), (0.3, 5, 0, False), (1.2, 30, 90, False),
    (1.5, 15, 180, False)])
def test_walls_at_the_height_of_the_floor_are_no_floor(height_m, pitch_deg, roll_deg, is_half,
                                                       factor):
    """With a wrong unit, some pixels of a wall or of clutter are that far below the camera."""
    boxes = [(x, y, (0.3, 0.3, size)) for x, y, size in
             ((-1.2, 2.5, 1.1), (-0.6, 3.2, 0.4), (0.4, 2.2, 0.2), (1.0, 3.0, 0.9))]
    view = seen(course(6.0, boxes=boxes), height_m, pitch_deg, roll_deg, is_half=is_half,
                noise=0.001)
    assert not detect(view, height_m=height_m).ground_result.drop_note
    found = detect(view, factor * view.depth_m, height_m)
    assert 'm below the camera, is not seen' in found.ground_result.drop_note
    assert len(found.drops_m) == 0


@pytest.mark.parametrize('sides', [(1, 1), (3, 3), (2, 40), (8, 8), (15, 20)])
def test_a_tiny_image_has_no_ground_and_says_why(sides):
    height, width = sides
    lens = CameraIntrinsics(10.0, 10.0, width / 2, height / 2, width, height)
    view = SimpleNamespace(lens=lens, down=np.array([0.0, 0.6, 0.8]))
    found = see(detector(0.5), view, np.full(sides, 1.0))
    assert f'{width} x {height} pixels is too small' in found.ground_result.drop_note
    assert not found.ground.any() and not found.ground_result.is_known


@pytest.mark.parametrize('height_m', [0.0, 0.6])
def test_walls_alone_give_no_drop_and_why(height_m):
    view = seen(course(3.0), 0.6, -25)
    found = detect(view, height_m=height_m)
    assert 'seen' in found.ground_result.drop_note
    assert found.obstacles.sum() > 0.99 * np.isfinite(view.depth_m).sum() > 0


# Constants in depth: fronts are obstacles, masks and the end of the range are none.
def in_millimetres(view, noise, seed=0):
    """Return depth with noise that grows with its square, in whole millimetres."""
    rng = np.random.default_rng(seed)
    return np.round(view.depth_m + rng.normal(0, noise, view.depth_m.shape) * view.depth_m**2, 3)


def before(view, height_m, front_m, width_m, top_m):
    """Return the pixels of a front parallel to the image, and their height over the floor."""
    (x, y), down = pixel_rays(view.lens), view.down
    above_m = height_m - front_m * (down[0] * x + down[1] * y[:, None] + down[2])
    side = np.cross(down, [0, 0, 1])
    aside_m = front_m * (side[0] * x + side[1] * y[:, None]) / np.linalg.norm(side)
    return (above_m > 0) & (above_m < top_m) & (abs(aside_m) < width_m / 2), above_m


@pytest.mark.parametrize('stated', [False, True])
@pytest.mark.parametrize('front_m, height_m, pitch_deg, roll_deg, noise, is_half', [
    (1.2, 0.6, 15, 0, 0.001, False), (1.7, 0.4, 10, 90, 0.003, False),
    (2.0, 1.0, 25, 4, 0.002, True), (1.0, 0.15, 3, 180, 0.003, False),
    (1.5, 0.8, 20, -90, 0.002, True), (3.0, 0.5, 8, 0, 0.001, False)])
def test_a_front_that_repeats_one_depth_is_an_obstacle(front_m, height_m, pitch_deg, roll_deg,
                                                       noise, is_half, stated):
    view = seen(course(7.0), height_m, pitch_deg, roll_deg, is_half=is_half)
    at, above_m = before(view, height_m, front_m, 0.7, 0.5)
    depth_m = np.where(at, front_m, in_millimetres(view, noise))
    found = detect(view, depth_m, height_m if stated else 0.0)
    front, floor = at & (above_m > 0.06), (view.kinds == Kind.FLOOR) & ~at
    assert front.sum() > 2000 and found.obstacles[front].mean() > 0.99
    np.testing.assert_allclose(found.depth_m[front], front_m, rtol=1e-6)
    assert abs(found.ground_result.heights_m[front] - above_m[front]).max() < 0.05
    assert found.obstacles[floor].mean() < 0.005 and found.ground[floor].mean() > 0.97
    assert 'front of an obstacle' in found.constant_note or not found.constant_note
    # Not if it is said to be the robot.
    box = (-9.0, -9.0, front_m - 0.01, 9.0, 9.0, front_m + 0.01)
    assert not detect(view, depth_m, ignore_box=box).obstacles[at].any()


def test_a_front_is_an_obstacle_where_no_floor_is_seen():
    view = seen(course(4.0), 0.6, -35)
    at = np.zeros(view.depth_m.shape, bool)
    at[150:400, 200:500] = True
    found = detect(view, np.where(at, 1.3, in_millimetres(view, 0.002)))
    assert found.obstacles[at].all() and np.isnan(found.ground_result.heights_m[at]).all()


@pytest.mark.parametrize('value_m', [1.0, 2.0, 5.0, 10.0, 65.535])
@pytest.mark.parametrize('height_m, pitch_deg, roll_deg, rows', [
    (0.6, 15, 0, slice(380, None)), (0.5, 20, 180, slice(0, 110)), (0.7, 30, 2, slice(340, None))])
def test_a_mask_of_the_body_is_no_obstacle(height_m, pitch_deg, roll_deg, rows, value_m):
    """It would be below the floor."""
    view = seen(course(7.0), height_m, pitch_deg, roll_deg)
    depth_m = in_millimetres(view, 0.002)
    depth_m[rows] = value_m
    found = detect(view, depth_m)
    assert not found.obstacles[rows].any() and np.isnan(found.depth_m[rows]).all()
    rest = view.kinds == Kind.FLOOR
    rest[rows] = False
    assert found.ground[rest].mean() > 0.97 and 'front' not in found.constant_note
    assert len(found.drops_m) == 0


@pytest.mark.parametrize('limit_m', [2.5, 4.0])
def test_the_end_of_the_range_as_a_constant_is_no_obstacle(limit_m):
    view = seen(course(7.0), 0.6, 15, noise=0.0)
    measured_m = in_millimetres(view, 0.002)
    far, depth_m = measured_m > limit_m, np.minimum(measured_m, limit_m)
    for one, is_stated in ((detector(), False), (detector(max_range=limit_m), True)):
        found = see(one, view, depth_m)
        assert not found.obstacles[far].any() and np.isnan(found.depth_m[far]).all()
        assert ('a front with nothing seen farther' in found.constant_note) != is_stated
        assert len(found.drops_m) == 0


@pytest.mark.parametrize('front_m', [1.2, 3.0])
def test_a_front_before_all_is_an_obstacle_if_near_or_nearer_than_what_was_seen(front_m):
    """Alone in view, it may be the end of the range; the stream has seen farther before."""
    view = seen(course(7.0), 0.6, 12)
    at, above_m = before(view, 0.6, front_m, 20.0, 9.0)
    depth_m = np.where(at, front_m, in_millimetres(view, 0.002))
    stream, fresh = detector(), detector()
    see(stream, view, in_millimetres(view, 0.002, 1))
    front = at & (above_m > 0.06)
    assert see(stream, view, depth_m).obstacles[front].mean() > 0.99
    found = see(fresh, view, depth_m)
    assert found.obstacles[front].mean() > 0.99 if front_m < 1.8 else (
        'a front with nothing seen farther' in found.constant_note)


# 6. Reflections are no holes.
@pytest.mark.parametrize('height_m, pitch_deg, roll_deg, patch, ceiling_m, noise, is_half', [
    (0.6, 20, 0, (-0.5, 0.4, 1.2, 1.8), 2.6, 0.0, False),
    (1.0, 30, 90, (-0.3, 0.6, 1.0, 1.6), 2.4, 0.001, False),
    (0.4, 12, 3, (-0.8, 0.8, 0.9, 2.0), 3.0, 0.002, True),
    (0.8, 25, 180, (0.0, 0.3, 1.1, 1.5), 2.2, 0.001, False)])
def test_a_reflecting_floor_is_no_hole(height_m, pitch_deg, roll_deg, patch, ceiling_m, noise,
                                       is_half):
    view = seen(course(5.0, ceiling_m=ceiling_m), height_m, pitch_deg, roll_deg, is_half=is_half,
                noise=noise)
    x, y = view.points_m[..., 0], view.points_m[..., 1]
    mirrors = ((view.kinds == Kind.FLOOR) & (x > patch[0]) & (x < patch[1]) & (y > patch[2])
               & (y < patch[3]))
    assert mirrors.sum() > 2000
    mirrored_m = view.depth_m * (height_m + ceiling_m) / height_m
    found = detect(view, np.where(mirrors, mirrored_m, view.depth_m))
    assert len(found.drops_m) == 0 and not found.ground_result.drop_note


# 7. Bent depth.
def bent(view, share):
    """Return depth off by a share that grows to the corners, smoothly."""
    v, u = np.indices(view.depth_m.shape)
    corner = ((u - view.lens.cx)**2 + (v - view.lens.cy)**2) / (
        view.lens.cx**2 + view.lens.cy**2)
    return view.depth_m * (1 + share * (corner - 0.35))


@pytest.mark.parametrize('stated', [False, True])
@pytest.mark.parametrize('height_m, pitch_deg, share, is_half', [
    (0.6, 20, 0.08, False), (0.6, 20, -0.08, False), (0.4, 12, 0.1, True), (0.4, 12, -0.1, False),
    (1.0, 30, 0.05, False), (1.0, 30, -0.04, True), (0.6, 35, 0.08, False)])
def test_a_bent_floor_stays_floor(height_m, pitch_deg, share, is_half, stated):
    view = seen(course(5.0, boxes=[(0.3, 2.0, (0.3, 0.3, 0.4))]), height_m, pitch_deg,
                is_half=is_half)
    found = detect(view, bent(view, share), height_m if stated else 0.0)
    is_floor = view.kinds == Kind.FLOOR
    assert found.ground[is_floor].mean() > 0.995 and found.obstacles[is_floor].mean() < 0.005
    labels = found.labels[is_floor]
    pixels = np.bincount(labels[labels >= 0], minlength=len(found.planes))
    floors = np.array(found.classes) == PlaneClass.FLOOR
    assert pixels[floors].sum() > 0.95 * pixels.sum() - 0.01 * is_floor.sum()
    assert found.obstacles[(view.kinds == Kind.OBSTACLE) & (view.above_m > 0.08)].mean() > 0.97
    assert len(found.drops_m) == 0


# 8. Specks and flying pixels.
@pytest.mark.parametrize('size_px, count, is_half, seed', [(4, 40, False, 0), (3, 60, True, 1),
                                                            (6, 25, False, 2), (2, 200, False, 3)])
def test_specks_in_free_space_are_no_obstacles(size_px, count, is_half, seed):
    rng = np.random.default_rng(seed)
    view = seen(course(5.0), 0.6, 20, is_half=is_half, noise=0.0005)
    depth_m, is_speck = view.depth_m.copy(), np.zeros(view.depth_m.shape, bool)
    for v, u in zip(rng.integers(0, depth_m.shape[0] - size_px, count),
                    rng.integers(0, depth_m.shape[1] - size_px, count), strict=True):
        there = slice(v, v + size_px), slice(u, u + size_px)
        if not is_speck[there].any():
            depth_m[there], is_speck[there] = rng.uniform(0.4, 0.8) * depth_m[there].min(), True
    found = detect(view, depth_m)
    assert found.obstacles[is_speck].mean() < 0.02
    assert found.obstacles[(view.kinds == Kind.OBSTACLE) & ~is_speck
                           & (view.above_m > 0.1)].mean() > 0.99


@pytest.mark.parametrize('roll_deg, is_half, seed', [(0, False, 0), (90, False, 1),
                                                     (180, True, 2)])
def test_torn_rims_of_blind_spots_in_the_floor_are_no_obstacles(roll_deg, is_half, seed):
    """Too deep by up to 12 % where a light is reflected; a box among them stays an obstacle."""
    rng = np.random.default_rng(seed)
    view = seen(course(5.0, boxes=[(0.5, 1.6, (0.3, 0.3, 0.3))]), 1.0, 30, roll_deg,
                is_half=is_half, noise=0.0005)
    depth_m, is_rim = view.depth_m.copy(), np.zeros(view.depth_m.shape, bool)
    v, u = np.indices(depth_m.shape)
    floor = np.argwhere(view.kinds == Kind.FLOOR)
    unit = 0.5 if is_half else 1.0
    for row, column in floor[rng.integers(0, len(floor), 8)]:
        radius = np.hypot((v - row) / (20 * unit), (u - column) / (35 * unit))
        depth_m[(radius < 1) & (view.kinds == Kind.FLOOR)] = np.nan
        is_rim |= (radius >= 1) & (radius < 1.25) & (view.kinds == Kind.FLOOR)
    bumps = abs(cv2.GaussianBlur(rng.normal(size=depth_m.shape), (0, 0), 3 * unit))
    depth_m[is_rim] *= 1 + 0.12 * (bumps / bumps.max())[is_rim]
    found = detect(view, depth_m)
    is_rim &= np.isfinite(depth_m)
    assert is_rim.sum() > 400 * unit and found.obstacles[is_rim].mean() < 0.02
    assert found.obstacles[(view.kinds == Kind.OBSTACLE) & (view.above_m > 0.1)].mean() > 0.98
    assert not len(found.drops_m)


@pytest.mark.parametrize('size_px, is_half, noise', [(5, False, 0.0), (3, True, 0.0),
                                                      (7, False, 0.0005)])
def test_flying_pixels_are_no_obstacles_and_things_are(size_px, is_half, noise):
    way = course(4.5, boxes=[(-0.4, 1.5, (0.3, 0.3, 0.5)), (0.5, 2.0, (0.02, 0.02, 0.8)),
                             (0.9, 2.2, (0.8, 0.6, 0.03), 0.7)])
    view = seen(way, 1.0, 20, is_half=is_half, noise=noise)
    smeared_m = cv2.blur(view.depth_m, (size_px, size_px))
    # Between two surfaces, clearly off both.
    low = cv2.erode(view.depth_m, np.ones((size_px, size_px)))
    high = cv2.dilate(view.depth_m, np.ones((size_px, size_px)))
    is_flying = np.minimum(smeared_m - low, high - smeared_m) > 0.08 * smeared_m
    found = detect(view, smeared_m)
    assert is_flying.sum() > 1000 and found.obstacles[is_flying].mean() < 0.1
    is_clean = high - low < 0.02 * low
    assert found.obstacles[is_clean & (view.kinds == Kind.OBSTACLE)
                           & (view.above_m > 0.1)].mean() > 0.98


@pytest.mark.parametrize('is_half', [False, True])
@pytest.mark.parametrize('noise', [0.0, 0.001, 0.004])
def test_a_thin_leg_and_a_small_box_are_obstacles(noise, is_half):
    way = course(4.5, boxes=[(-0.4, 2.0, (0.02, 0.02, 0.6)), (0.4, 2.0, (0.08, 0.08, 0.08))])
    view = seen(way, 0.6, 15, is_half=is_half, noise=noise)
    found = detect(view)
    for x, height_m in ((-0.4, 0.6), (0.4, 0.08)):
        thing = ((abs(view.points_m[..., 0] - x) < 0.06) & (abs(view.points_m[..., 1] - 2) < 0.1)
                 & (view.above_m > 0.06) & (view.kinds == Kind.OBSTACLE))
        assert thing.sum() > 20 and found.obstacles[thing].mean() > 0.8
        assert found.ground_result.heights_m[thing].max() == pytest.approx(
            height_m, abs=0.03 + 8 * noise)


# 9. How sure.
@pytest.mark.parametrize('noise', [0.001, 0.004])
def test_sigma_is_the_spread_of_the_heights(noise):
    view = seen(course(), 0.8, 25, noise=noise)
    found = detect(view)
    for far_m in (1.0, 2.0):
        near = (view.kinds == Kind.FLOOR) & (abs(view.points_m[..., 1] - far_m) < 0.05)
        result, spread_m = found.ground_result, found.ground_result.heights_m[near].std()
        assert np.median(result.height_sigmas_m[near]) == pytest.approx(spread_m, rel=0.5)
    one, two, three = found.ground_result.smallest_obstacles_m
    assert 0.05 == one <= two <= three < 0.12


@pytest.mark.parametrize('stated_m, roll_deg, problem', [
    (0.6, 0, ''), (0.61, 90, ''), (0.65, 0, '0.60 m below the camera, not 0.65 m as stated'),
    (0.9, 180, '0.60 m below the camera, not 0.90 m as stated')])
def test_a_wrong_height_of_the_camera_is_noticed(stated_m, roll_deg, problem):
    found = detect(seen(course(), 0.6, 20, roll_deg, noise=0.001), height_m=stated_m)
    said = found.ground_result.mounting.problem
    assert problem in said and bool(problem) == bool(said)


@pytest.mark.parametrize('axis', [(1, 0, 0), (0, 0, 1)])
@pytest.mark.parametrize('off_deg, is_wrong', [(1.0, False), (5.0, True), (-7.0, True)])
def test_a_wrong_tilt_of_the_camera_is_noticed(off_deg, is_wrong, axis):
    view = seen(course(), 0.6, 20, noise=0.001)
    turn, _ = cv2.Rodrigues(np.radians(off_deg) * np.array(axis, float))
    found = detect(view, down=turn @ view.down)
    assert ('tilted' in found.ground_result.mounting.problem) == is_wrong
    assert found.ground_result.mounting.tilt_deg == pytest.approx(20.0, abs=0.3)
    assert np.isnan(found.ground_result.mounting.stated_height_m)


def test_what_of_the_robot_itself_is_in_view_is_ignored():
    view = seen(course(boxes=[(0.0, 0.45, (1.2, 0.5, 0.45))]), 1.0, 30)
    is_deck = (view.kinds == Kind.OBSTACLE) & (view.points_m[..., 1] < 0.75)
    points = view.depth_m[is_deck]
    assert is_deck.sum() > 10000
    as_floor = detect(view)
    assert as_floor.ground[is_deck].mean() > 0.9 and len(as_floor.drops_m) > 100
    box = (-1.0, -1.0, 0.0, 1.0, 1.0, float(points.max()) + 0.01)
    found = detect(view, ignore_box=box)
    assert found.camera_height_m == pytest.approx(1.0, abs=0.02) and len(found.drops_m) == 0
    assert not found.ground[is_deck].any() and not found.obstacles[is_deck].any()
    with pytest.raises(ValueError, match='ignore_box must be 6 numbers'):
        detect(view, ignore_box=(1.0, 0, 0, 0, 0, 0))


# 10. Planted errors that no test caught.
def test_the_box_that_is_ignored_has_six_sides():
    depth_m = np.random.default_rng(0).uniform(0.5, 3.0, (48, 64)).astype(np.float32)
    rays = pixel_rays(CameraIntrinsics(40.0, 36.0, 30.0, 25.0, 64, 48))
    points_m = np.stack([depth_m * rays[0], depth_m * rays[1][:, None], depth_m], axis=-1)
    box = np.array([-0.3, -0.2, 0.8, 0.5, 0.35, 2.1], np.float32)
    inside = ((points_m >= box[:3]) & (points_m <= box[3:])).all(axis=-1)
    found_m, labels = without_box(depth_m, np.zeros((48, 64), np.int32), *rays, box)
    assert 100 < inside.sum() < inside.size - 100
    np.testing.assert_array_equal(found_m, np.where(inside, np.nan, depth_m))
    np.testing.assert_array_equal(labels, np.where(inside, -1, 0))


def test_classes_without_a_unit_are_those_of_any_unit_but_for_steps():
    """Without the unit the camera counts as 1 m high; a step is so many metres high."""
    way = course()
    way.add_box(0.0, 2.4, np.array([4.0, 1.0, 0.25]))
    view = seen(way, 1.0, 22)
    found = detect(view)
    assert PlaneClass.STEP in found.classes
    expected = tuple(PlaneClass.OTHER_HORIZONTAL if kind == PlaneClass.STEP else PlaneClass(kind)
                     for kind in found.classes)
    for unit in (0.1, 7.0):
        planes = found.planes
        scaled = replace(planes, offsets_m=unit * planes.offsets_m,
                         centroids_m=unit * planes.centroids_m,
                         covariances=planes.covariances * np.outer([1, 1, 1, unit],
                                                                   [1, 1, 1, unit]))
        ground = find_ground(
            PlaneSegmentation(scaled, found.labels, found.disparity_noise / unit),
            unit * view.depth_m, view.lens, Gravity(view.down.copy(), 1.0, 'measured'), Config(),
            is_metric=False)
        assert tuple(ground.classes) == expected


# 11. The least height of an obstacle holds for planes too.
@pytest.mark.parametrize('min_height', [0.05, 0.12, 0.2])
@pytest.mark.parametrize('height_m, pitch_deg, roll_deg, is_half, noise', [
    (0.6, 20, 0, False, 0.0005), (0.35, 12, 90, False, 0.001), (1.2, 35, 0, True, 0.0),
    (1.5, 65, 180, False, 0.001)])
def test_what_is_lower_than_min_height_is_no_obstacle_and_what_is_higher_is(
        height_m, pitch_deg, roll_deg, is_half, noise, min_height):
    """Plates and boxes as planes, a wall 2 cm thick, a riser with a level behind it."""
    near_m = 0.3 if pitch_deg > 50 else 1.0
    way = course(4.5, boxes=[(-0.5, near_m, (0.3, 0.3, 0.04)), (-0.1, near_m, (0.25, 0.25, 0.1)),
                             (0.2, near_m, (0.25, 0.25, 0.17)), (0.38, near_m, (0.02, 0.4, 0.4)),
                             (0.0, near_m + 0.6, (3.0, 0.5, 0.15))])
    view = seen(way, height_m, pitch_deg, roll_deg, is_half=is_half, noise=noise)
    found = detect(view, min_height=min_height)
    is_thing = (view.kinds == Kind.OBSTACLE) & (view.points_m[..., 1] < near_m + 0.8)
    error_m = 0.01 + 3 * noise * height_m * 2
    low = is_thing & (view.above_m < min_height - error_m)
    high = is_thing & (view.above_m > min_height + error_m)
    assert low.sum() > 1000 and found.obstacles[low].mean() < 0.005
    assert high.sum() > 300 and found.obstacles[high].mean() > 0.97
    assert not (abs(found.ground_result.heights_m[found.obstacles]) <= min_height).any()
    # They are no ground for that: the step of the level is higher than max_step.
    level = (view.kinds == Kind.OBSTACLE) & (abs(view.above_m - 0.15) < 0.005)
    assert found.ground[level].mean() < 0.05
