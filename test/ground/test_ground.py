# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Rendered terrain through the whole pipeline: ground, obstacles, drops, classes."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from plane_detector import Config, PlaneDetector
from plane_detector.config import DepthConfig, GroundConfig, ScaleConfig
from plane_detector.depth.observation import DepthFunction
from plane_detector.evaluation.benchmark import ground as ground_benchmark
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rendering import rectangle
from plane_detector.evaluation.scenes.terrain import (
    Course,
    Kind,
    View,
    hole,
    kerb,
    look,
    noisy,
    patch,
    quay,
    ramp,
    stairs,
)
from plane_detector.evaluation.scenes.terrain import terrain as random_terrain
from plane_detector.ground.ground import find_ground
from plane_detector.planes.classification import PlaneClass
from plane_detector.types import NO_PLANES, CameraIntrinsics, Gravity, PlaneSegmentation

MEASURED = Config(depth=DepthConfig(source='topic'))
FROM_ABOVE = View(1.0, 25.0, roll_deg=3.0)


def detect(terrain, depth_m=None, config=MEASURED, gravity_camera=None):
    scene = terrain.scene
    depth_m = noisy(terrain, 0.001, np.random.default_rng(1)) if depth_m is None else depth_m
    down = scene.gravity_camera if gravity_camera is None else gravity_camera
    return PlaneDetector(config).detect(scene.rgb, scene.intrinsics, depth_m, down)


def share(found, terrain, *kinds):
    """Return the share of the pixels of some kinds that is ground."""
    return found.ground[np.isin(terrain.kinds, kinds)].mean()


def class_of(found, terrain, kind):
    """Return the class of most pixels of a kind."""
    labels = found.labels[terrain.kinds == kind]
    return found.classes[np.bincount(labels[labels >= 0]).argmax()]


def off_edges_m(found, terrain):
    """Return how far each drop is from the nearest true edge."""
    edges_m = np.vstack([terrain.edges_m, np.full(3, np.inf)])
    return np.linalg.norm(terrain.in_world(found.drops_m)[:, None] - edges_m, axis=2).min(axis=1)


def course(make, *args, start_m=2.0, view=FROM_ABOVE, seed=3):
    rng = np.random.default_rng(seed)
    return look(make(rng, start_m, *args), view, rng)


def laid(half_width_m, *ways, view=FROM_ABOVE, boxes=()):
    """Return the view of a floor that goes on to some y and z as some kinds, with boxes on it."""
    way = Course(half_width_m)
    for y, z, kind in ways:
        way.on(y, z, kind)
    for x, y, size in boxes:
        way.add_box(x, y, np.array(size))
    return look(way, view, np.random.default_rng(3))


def sloping(slope_deg, view=FROM_ABOVE):
    """Return a ramp that begins after 1.5 m and rises over 2 m."""
    rise = 2.0 * np.tan(np.radians(slope_deg))
    return laid(2.0, (1.5, 0.0, Kind.FLOOR), (3.5, rise, Kind.RAMP), (9.0, rise, Kind.LANDING),
                view=view)


@pytest.mark.parametrize('sign', [1, -1])
def test_a_ramp_and_the_level_behind_it_are_ground(sign):
    terrain = course(ramp, sign)
    found = detect(terrain)
    assert share(found, terrain, Kind.FLOOR) > 0.98
    assert share(found, terrain, Kind.RAMP, Kind.LANDING) > 0.97
    assert class_of(found, terrain, Kind.FLOOR) == PlaneClass.FLOOR
    assert class_of(found, terrain, Kind.RAMP) == PlaneClass.RAMP
    assert off_edges_m(found, terrain).max(initial=0.0) < 0.1


@pytest.mark.parametrize('roll_deg', [0, 40, 90])
def test_a_slope_beside_the_robot_is_ground(roll_deg):
    """It rises by 8 degrees from below the camera on: no way leads from the level to the slope."""
    camera, down = CameraIntrinsics(525.0, 525.0, 319.5, 239.5, 640, 480), np.radians(25.0)
    roll, _ = cv2.Rodrigues(np.radians(roll_deg) * np.array([0.0, 0.0, 1.0]))
    v, u = np.mgrid[:480, :640]
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)])
    x, y, _ = np.tensordot(roll.T, rays, 1)
    fall = np.cos(down) * y + np.sin(down)  # of a ray at depth 1
    least = np.maximum(np.maximum(fall, fall + np.tan(np.radians(8.0)) * x), 1 / 8)
    inverse = least + np.random.default_rng(0).normal(0, 0.001, x.shape)
    depth_m = np.where(least > 1 / 8, 1 / inverse, np.nan).astype(np.float32)
    found = PlaneDetector(MEASURED).detect(np.full((480, 640, 3), 128, np.uint8), camera, depth_m,
                                           roll @ np.array([0.0, np.cos(down), np.sin(down)]))
    assert found.ground[np.isfinite(depth_m)].mean() > 0.98


@pytest.mark.parametrize('name, seed', [('ramp up', 107), ('ramp up', 113), ('ramp down', 110)])
def test_a_far_or_small_landing_is_ground(name, seed):
    """The last keeps its plane, though near ground is exact; the others are too small for one."""
    terrain = random_terrain(name, np.random.default_rng([seed, *name.encode()]))
    found = detect(terrain)
    assert share(found, terrain, Kind.LANDING) > 0.95
    assert name == 'ramp up' or (found.labels[terrain.kinds == Kind.LANDING] >= 0).mean() > 0.95


@pytest.mark.parametrize('seed', [506, 529, 530, 538])
def test_noise_does_not_hide_a_ramp_that_has_no_plane(seed):
    """At .004 1/m floor and ramp may be taken for one curved surface, which has no plane."""
    terrain = random_terrain('ramp down', np.random.default_rng([seed, *b'ramp down']))
    found = detect(terrain, noisy(terrain, 0.004, np.random.default_rng([seed, 1])))
    assert share(found, terrain, Kind.FLOOR) > 0.98
    assert share(found, terrain, Kind.RAMP) > 0.97
    assert share(found, terrain, Kind.LANDING) > 0.85


@pytest.mark.parametrize('seed', [9007, 9020])
def test_a_ramp_taken_for_a_curved_surface_leads_to_the_level_behind_it(seed):
    judged = ground_benchmark.measure('ramp up', seed, 0.004)
    assert min(judged['floor'], judged['ramp'], judged['landing']) > 0.97


@pytest.mark.parametrize('radius_m, noise, seed', [
    (12.0, 0.0, 0), (12.0, 0.004, 0), (12.0, 0.004, 1), (20.0, 0.001, 1), (20.0, 0.004, 0),
    (40.0, 0.0, 0), (-12.0, 0.004, 2)])
def test_a_gently_curved_floor_is_ground(radius_m, noise, seed):
    """It rises or falls away from the robot, nowhere by more than 13 degrees."""
    camera, tilt = CameraIntrinsics(525.0, 525.0, 319.5, 239.5, 640, 480), np.radians(20.0)
    y = ((np.arange(480) - camera.cy) / camera.fy)[:, None]
    ahead, below = np.cos(tilt) - np.sin(tilt) * y, np.sin(tilt) + np.cos(tilt) * y
    # The camera is 1 m over the floor: 1 - z below = (z ahead)^2 / (2 radius)
    square = below**2 + 2 * ahead**2 / radius_m
    z = (np.sqrt(np.maximum(square, 0)) - below) * radius_m / ahead**2
    steepest_m = min(5.0, abs(radius_m) * np.tan(np.radians(13.0)))
    z = np.where((square >= 0) & (z > 0) & (z * ahead <= steepest_m), z, np.nan)
    depth_m = np.repeat(z, 640, axis=1).astype(np.float32)
    if noise:
        depth_m = with_disparity_noise(depth_m, noise, np.random.default_rng(seed))
    found = PlaneDetector(MEASURED).detect(np.full((480, 640, 3), 128, np.uint8), camera, depth_m,
                                           np.array([0.0, np.cos(tilt), np.sin(tilt)]))
    is_seen = np.isfinite(depth_m)
    assert found.ground[is_seen].mean() > 0.99
    assert found.obstacles[is_seen].mean() < 0.01


def ground_by_pixels(terrain):
    """Return the ground of exact depth of which only the own floor is a plane."""
    scene = terrain.scene
    found = detect(terrain, scene.depth_m)
    own = found.labels[-1, 320]
    planes = PlaneSegmentation(found.planes.selected([own]),
                               np.where(found.labels == own, 0, -1), 0.0)
    return find_ground(planes, scene.depth_m, scene.intrinsics,
                       Gravity(scene.gravity_camera, 1.0, 'measured'), MEASURED).result.mask


@pytest.mark.parametrize('slope_deg, is_ground', [(10.0, True), (25.0, False)])
def test_pixels_without_a_plane_lead_up_a_ramp(slope_deg, is_ground):
    terrain = sloping(slope_deg)
    high = (terrain.kinds == Kind.RAMP) & (terrain.points_m[..., 2] > 0.15)
    assert high.sum() > 10000 and abs(ground_by_pixels(terrain)[high].mean() - is_ground) < 0.05


def test_what_is_too_small_for_a_plane_behind_an_obstacle_is_ground_only_at_its_level():
    terrain = laid(2.0, (8.0, 0.0, Kind.FLOOR),
                   boxes=[(0, 1.5, [2.0, 0.1, 0.15]), (0, 2.0, [2.0, 0.1, 0.25])])
    high = (terrain.kinds == Kind.OBSTACLE) & (terrain.above_m > 0.051)
    assert high.sum() > 10000 and not ground_by_pixels(terrain)[high].any()


def test_a_rough_floor_without_a_plane_is_the_own_floor():
    terrain = course(kerb, -1, 0.2, start_m=1.6, view=View(0.8, 30.0))
    relief = np.random.default_rng(3).normal(0, 0.02, (96, 128)).astype(np.float32)
    relief = cv2.resize(relief, (640, 480), interpolation=cv2.INTER_CUBIC)
    scene, nothing = terrain.scene, np.full(relief.shape, -1, np.int32)
    ground, coarse = (find_ground(
        PlaneSegmentation(NO_PLANES, nothing, 0.003), scene.depth_m * (1 + relief),
        scene.intrinsics, Gravity(scene.gravity_camera.copy(), tolerance_deg, 'measured'),
        MEASURED) for tolerance_deg in (1.0, 8.0))
    assert not coarse.result.is_known and 'too coarsely' in coarse.result.drop_note
    assert ground.result.camera_height_m == pytest.approx(0.8, abs=0.01)
    assert ground.result.mask[terrain.kinds == Kind.FLOOR].mean() > 0.97
    assert len(ground.result.drops_m) > 100 and off_edges_m(ground.result, terrain).max() < 0.1


LEGS = GroundConfig(max_step=0.2, min_height=0.2, max_slope=30.0, min_drop=0.25)
# What is seen, the settings, a kind, and the least and the largest share of it that is ground.
ROBOTS = {
    'stairs up for legs': (lambda: course(stairs, 1, start_m=1.5), LEGS, Kind.UPPER, 0.85, 1),
    'stairs down for legs': (lambda: course(stairs, -1, start_m=1.5), LEGS, Kind.LOWER, 0.85, 1),
    'a steep ramp for legs': (lambda: sloping(25.0, View(1.4, 20.0)),
                              GroundConfig(max_slope=30.0), Kind.RAMP, 0.97, 1),
    'a steep ramp for wheels': (lambda: sloping(25.0, View(1.4, 20.0)), GroundConfig(),
                                Kind.RAMP, 0, 0.1),
    'a ramp steeper than wanted': (lambda: course(ramp, 1), GroundConfig(max_slope=2.0),
                                   Kind.RAMP, 0, 0.2),
    'a kerb up': (lambda: course(kerb, 1, 0.1), GroundConfig(), Kind.UPPER, 0, 0.02),
    'a kerb up that it climbs': (lambda: course(kerb, 1, 0.1), GroundConfig(
        max_step=0.15, min_height=0.15), Kind.UPPER, 0.98, 1)}


@pytest.mark.parametrize('name', ROBOTS)
def test_ground_is_where_the_robot_can_go(name):
    see, settings, kind, least, most = ROBOTS[name]
    terrain = see()
    found = detect(terrain, config=replace(MEASURED, ground=settings))
    assert least <= share(found, terrain, kind) <= most


def test_the_own_floor_at_the_head_of_stairs_is_the_highest():
    terrain = course(stairs, -1, start_m=1.5)
    found = detect(terrain)
    assert class_of(found, terrain, Kind.FLOOR) == PlaneClass.FLOOR
    assert share(found, terrain, Kind.FLOOR) > 0.98
    assert found.camera_height_m == pytest.approx(1.0, abs=0.01)
    assert found.tilt_deg == pytest.approx(25.0, abs=0.5)
    first_m = terrain.edges_m[terrain.edges_m[:, 2] == 0]
    drops_m = terrain.in_world(found.drops_m)
    seen = abs(drops_m[:, 2]) < 0.05
    assert np.ptp(drops_m[seen, 0]) > 0.8 * np.ptp(first_m[:, 0]) or seen.sum() > 200
    assert np.median(found.ground_result.drop_depths_m[seen]) == pytest.approx(
        terrain.drops_m[0], rel=0.2)


@pytest.mark.parametrize('noise', [0.004, 'kinect'])
@pytest.mark.parametrize('seed', [515, 544, 595])
def test_the_own_floor_is_a_strip_below_from_which_the_camera_looks_past_an_edge(seed, noise):
    """The camera is rolled, so that some columns see the landing below alone."""
    terrain = random_terrain('stairs down', np.random.default_rng([seed, *b'stairs down']))
    found = ground_benchmark.detect(terrain, noise, seed)
    assert 0.01 < (terrain.kinds == Kind.FLOOR).mean() < 0.05
    assert found.camera_height_m == pytest.approx(terrain.position_m[2], rel=0.08)
    assert share(found, terrain, Kind.FLOOR) > 0.98


@pytest.mark.parametrize('noise', [0.002, 'kinect'])
@pytest.mark.parametrize('size, x_m, y_m, view', [
    ((1.2, 0.7, 0.7), -0.5, 1.2, View(1.3, 15.0, 5.0, 10.0)),
    ((1.6, 0.8, 0.7), 0.6, 1.4, View(1.2, 25.0, -5.0, -15.0)),
    ((0.8, 2.0, 0.5), -0.6, 1.6, View(1.0, 20.0, 4.0, 0.0)),
    ((1.4, 5.0, 0.4), 1.2, 3.0, View(0.9, 12.0, -6.0, 5.0))])
def test_what_ends_at_a_side_is_not_the_own_floor(size, x_m, y_m, view, noise):
    """Tables, a bed and a platform beside the robot, of which the near edge is out of view."""
    terrain = laid(3.0, (8.0, 0.0, Kind.FLOOR), view=view, boxes=[(x_m, y_m, size)])
    found = detect(terrain, noisy(terrain, noise, np.random.default_rng(1)))
    assert found.camera_height_m == pytest.approx(view.height_m, rel=0.05)
    assert share(found, terrain, Kind.FLOOR) > 0.95 and share(found, terrain, Kind.OBSTACLE) < 0.03


def test_stairs_up_are_steps_and_obstacles():
    terrain = course(stairs, 1)
    found = detect(terrain)
    assert share(found, terrain, Kind.FLOOR) > 0.98
    assert share(found, terrain, Kind.UPPER) < 0.02
    assert found.classes.count(PlaneClass.STEP) >= 2 and len(found.drops_m) == 0


@pytest.mark.parametrize('rise_m, run_m', [(0.17, 0.29), (0.19, 0.25), (0.14, 0.32)])
def test_a_riser_is_measured_from_the_tread_before_it_though_that_has_no_plane(rise_m, run_m):
    legs = GroundConfig(max_step=0.2, min_height=0.2, max_slope=30.0, min_drop=0.25)
    ways, y, z = [(0.7, 0.0, Kind.FLOOR)], 0.7, 0.0
    for _ in range(3):
        y, z = y + run_m, z + rise_m
        ways += [(y - run_m, z, Kind.OBSTACLE), (y, z, Kind.UPPER)]
    terrain = laid(0.8, *ways, (y, 2.0, Kind.OBSTACLE), view=View(0.55, 15.0))
    scene, depth_m = terrain.scene, noisy(terrain, 0.0015, np.random.default_rng(1))
    found, z_m = detect(terrain, depth_m, replace(MEASURED, ground=legs)), terrain.points_m[..., 2]
    second = (terrain.kinds == Kind.UPPER) & (abs(z_m - 2 * rise_m) < 0.01)
    assert second.sum() > 2000
    ground = find_ground(
        PlaneSegmentation(found.planes, np.where(second, -1, found.labels), found.disparity_noise),
        depth_m, scene.intrinsics, Gravity(scene.gravity_camera, 1.0, 'measured'),
        replace(MEASURED, ground=legs)).result
    front = terrain.kinds == Kind.OBSTACLE
    riser = front & (z_m > 2.1 * rise_m) & (z_m < 2.9 * rise_m)
    wall = front & (z_m > 2 * rise_m + 0.25)
    assert ground.mask[second].mean() > 0.8
    assert ground.obstacles[riser].mean() < 0.05 and ground.obstacles[wall].mean() > 0.98
    assert abs(np.median(ground.heights_m[riser]) - 0.5 * rise_m) < 0.04


@pytest.mark.parametrize('height_m, is_drop', [(0.05, False), (0.1, True), (0.2, True)])
def test_a_kerb_down_is_a_drop_above_min_drop(height_m, is_drop):
    terrain = course(kerb, -1, height_m)
    found = detect(terrain)
    assert (len(found.drops_m) > 200) == is_drop
    assert share(found, terrain, Kind.FLOOR) > 0.98
    if is_drop:
        assert off_edges_m(found, terrain).max() < 0.05
        assert np.median(found.ground_result.drop_depths_m) == pytest.approx(height_m, abs=0.02)
    higher = replace(MEASURED, ground=GroundConfig(min_drop=0.5))
    assert len(detect(terrain, config=higher).drops_m) == 0


def test_a_low_step_at_the_upper_end_of_a_ramp_is_no_drop():
    """What is behind it is far below the ramp, were it to go on."""
    top_m = 2.0 * np.tan(np.radians(8.0))
    terrain = laid(2.0, (1.5, 0.0, Kind.FLOOR), (3.5, top_m, Kind.RAMP),
                   (3.5, top_m - 0.06, Kind.OBSTACLE), (9.0, top_m - 0.06, Kind.LOWER))
    found = detect(terrain)
    assert share(found, terrain, Kind.RAMP) > 0.97 and len(found.drops_m) == 0


def test_a_drop_within_the_error_of_depth_is_none():
    """Behind the kerb the height of a pixel may be off by .1 m, three standard deviations."""
    terrain = course(kerb, -1, 0.15, start_m=3.5)
    scene = terrain.scene
    own = detect(terrain, scene.depth_m)
    floor = own.labels[-1, 320]
    counts = []
    for noise in (0.0, 0.008):
        planes = PlaneSegmentation(own.planes.selected([floor]),
                                   np.where(own.labels == floor, 0, -1), noise)
        ground = find_ground(planes, scene.depth_m, scene.intrinsics,
                             Gravity(scene.gravity_camera, 1.0, 'measured'), MEASURED)
        assert not ground.result.drop_note
        counts.append(len(ground.result.drops_m))
    assert counts[0] > 100 and counts[1] == 0


@pytest.mark.parametrize('make, least', [(hole, 20), (quay, 200)])
def test_a_hole_and_the_end_of_all_are_drops(make, least):
    terrain = course(make, start_m=1.5, view=replace(FROM_ABOVE, yaw_deg=8.0))
    found = detect(terrain)
    assert len(found.drops_m) > least and off_edges_m(found, terrain).max() < 0.05
    assert np.isnan(found.ground_result.drop_depths_m).all() == (make is quay)


def without_strip(terrain, depth_m, baseline_m=0.095):
    """Return depth as the left imager of two has it: none where the right one does not look."""
    camera = terrain.scene.intrinsics
    with np.errstate(invalid='ignore'):
        is_strip = np.arange(camera.width) < camera.fx * baseline_m / depth_m + 1
    return np.where(is_strip, np.nan, depth_m)


@pytest.mark.parametrize('quarters', [0, 1, 2, 3])
def test_the_strip_that_one_imager_sees_alone_is_no_drop(quarters):
    terrain = laid(6.0, (9.0, 0.0, Kind.FLOOR), view=View(0.6, 20.0, roll_deg=12.0),
                   boxes=[(0.5, 2.5, [0.3, 0.3, 0.4])])
    scene, down = terrain.scene, terrain.scene.gravity_camera
    depth_m = without_strip(terrain, noisy(terrain, 0.001, np.random.default_rng(1)))
    camera = scene.intrinsics
    for _ in range(quarters):
        depth_m = np.ascontiguousarray(np.rot90(depth_m))
        camera = CameraIntrinsics(camera.fy, camera.fx, camera.cy, camera.width - 1 - camera.cx,
                                  camera.height, camera.width)
        down = np.array([down[1], -down[0], down[2]])
    found = PlaneDetector(MEASURED).detect(np.zeros((*depth_m.shape, 3), np.uint8), camera,
                                           depth_m, down)
    assert found.ground.mean() > 0.3 and len(found.drops_m) == 0


@pytest.mark.parametrize('yaw_deg', [-60.0, 60.0])
@pytest.mark.parametrize('has_strip', [False, True])
def test_the_end_of_all_at_a_side_is_a_drop_also_to_a_stereo_camera(yaw_deg, has_strip):
    terrain = course(quay, start_m=1.0, view=View(0.6, 20.0, yaw_deg=yaw_deg))
    depth_m = noisy(terrain, 0.001, np.random.default_rng(1))
    found = detect(terrain, without_strip(terrain, depth_m) if has_strip else depth_m)
    assert len(found.drops_m) > 100 and off_edges_m(found, terrain).max() < 0.05


def test_an_edge_behind_a_box_is_not_claimed():
    terrain = laid(2.0, (2.0, 0.0, Kind.FLOOR), (2.0, -0.2, Kind.OBSTACLE),
                   (9.0, -0.2, Kind.LOWER), boxes=[(0, 1.9, [1.0, 0.15, 0.5])])
    drops_m = terrain.in_world(detect(terrain).drops_m)
    assert len(drops_m) > 100 and not (abs(drops_m[:, 0]) < 0.4).any()


def test_a_dark_floor_is_no_drop_while_something_is_seen_behind_it():
    assert len(detect(course(patch, start_m=1.5)).drops_m) == 0
    room = Course(2.0)
    room.on(9.0, 0.0, Kind.FLOOR)
    room.add_walls()
    terrain = look(room, View(1.0, 10.0), np.random.default_rng(3))
    is_far = terrain.points_m[..., 1] > 2.0
    before_a_wall = np.where((terrain.kinds == Kind.FLOOR) & is_far, np.nan, terrain.scene.depth_m)
    assert len(detect(terrain, before_a_wall).drops_m) == 0
    # With nothing behind, it is not told from the end of all: the safe answer, if more is seen
    # elsewhere, so that it is not the range of the sensor.
    is_far &= terrain.points_m[..., 0] < 0.5
    found = detect(terrain, np.where(is_far, np.nan, terrain.scene.depth_m))
    assert len(found.drops_m) > 100 and np.isnan(found.ground_result.drop_depths_m).all()


@pytest.mark.parametrize('width_m, height_m', [(0.5, 0.0), (2.6, 1.2)])
def test_a_table_is_no_floor_if_the_floor_is_seen_beside_it_or_the_height_is_known(width_m,
                                                                                   height_m):
    terrain = laid(3.0, (8.0, 0.0, Kind.FLOOR), view=View(1.2, 30.0),
                   boxes=[(0, 0.9, [width_m, 1.0, 0.7])])
    found = detect(terrain, config=replace(MEASURED, scale=ScaleConfig(camera_height=height_m)))
    assert found.camera_height_m == pytest.approx(1.2, abs=0.03)
    assert share(found, terrain, Kind.FLOOR) > 0.95 and share(found, terrain, Kind.OBSTACLE) < 0.02


def test_a_lower_level_at_the_side_is_not_the_own_floor():
    platform = Course(0.9)
    platform.on(8.0, 0.0, Kind.FLOOR)
    platform.add([rectangle([0.9, -3, -0.5], [6, 0, 0], [0, 11, 0])], Kind.LOWER)
    terrain = look(platform, View(0.8, 25.0), np.random.default_rng(2))
    found = detect(terrain)
    assert found.camera_height_m == pytest.approx(0.8, abs=0.01)
    assert share(found, terrain, Kind.FLOOR) > 0.98


@pytest.mark.parametrize('sign', [1, -1])
@pytest.mark.parametrize('axis', ['forward', 'sideways'])
@pytest.mark.parametrize('off_deg, tolerance_deg', [(1.5, 2.0), (3.0, 4.0), (6.0, 8.0),
                                                    (15.0, 20.0)])
def test_slopes_are_measured_against_the_own_floor(off_deg, tolerance_deg, axis, sign):
    terrain = course(ramp, sign)
    axes = np.radians(off_deg) * np.array([1.0, 0, 0] if axis == 'forward' else [0, 0, 1.0])
    turn, _ = cv2.Rodrigues(axes)
    config = replace(MEASURED, scale=ScaleConfig(gravity_tolerance=tolerance_deg))
    found = detect(terrain, config=config, gravity_camera=turn @ terrain.scene.gravity_camera)
    assert class_of(found, terrain, Kind.FLOOR) == PlaneClass.FLOOR
    assert class_of(found, terrain, Kind.RAMP) == PlaneClass.RAMP
    assert share(found, terrain, Kind.FLOOR, Kind.RAMP, Kind.LANDING) > 0.97
    assert found.tilt_deg == pytest.approx(25.0, abs=0.5)


def on_a_ramp(forward_m, slope_deg=8.0, height_m=0.8):
    """Look ahead from a robot on a floor, and on the ramp that begins after 2 m."""
    slope, start_m, length_m = np.radians(slope_deg), 2.0, 3.0
    way = Course(2.0)
    way.on(start_m, 0.0, Kind.FLOOR)
    way.on(start_m + length_m * np.cos(slope), length_m * np.sin(slope), Kind.RAMP)
    way.on(9.0, length_m * np.sin(slope), Kind.LANDING)
    way.add_walls()
    view = View(height_m, 22.0, forward_m=forward_m)
    if forward_m > start_m:
        view = View(height_m * np.cos(slope) + (forward_m - start_m) * np.tan(slope),
                    22.0 - slope_deg, forward_m=forward_m - height_m * np.sin(slope))
    return look(way, view, np.random.default_rng(3))


def test_surfaces_keep_their_labels_when_the_robot_drives_on_to_a_ramp():
    detector, seen = PlaneDetector(MEASURED), {Kind.FLOOR: [], Kind.RAMP: []}
    for number, forward_m in enumerate(np.arange(0.0, 3.1, 0.25)):
        terrain = on_a_ramp(forward_m)
        scene = terrain.scene
        found = detector.detect(scene.rgb, scene.intrinsics,
                                noisy(terrain, 0.001, np.random.default_rng(number)),
                                scene.gravity_camera)
        for kind, states in seen.items():
            labels = found.labels[terrain.kinds == kind]
            if (labels >= 0).sum() > 5000:
                plane = np.bincount(labels[labels >= 0]).argmax()
                states.append((found.planes.labels[plane], found.classes[plane]))
        assert share(found, terrain, Kind.FLOOR, Kind.RAMP) > 0.98
    assert len(set(seen[Kind.FLOOR])) == 1 and seen[Kind.FLOOR][0][1] == PlaneClass.FLOOR
    labels, classes = zip(*seen[Kind.RAMP], strict=True)
    on_ramp = classes.index(PlaneClass.FLOOR)
    assert len(classes) > 10 and len(set(labels)) == 1 and on_ramp > 2
    assert set(classes[:on_ramp]) == {PlaneClass.RAMP}
    assert set(classes[on_ramp:]) == {PlaneClass.FLOOR}
    assert found.camera_height_m == pytest.approx(0.8 / np.cos(np.radians(8.0)), abs=0.01)


def test_without_a_unit_there_are_classes_but_no_drops():
    scene = course(stairs, -1).scene
    relative = replace(MEASURED, depth=DepthConfig(output='relative_disparity'))
    found = PlaneDetector(relative, lambda rgb: 7.0 / scene.depth_m + 1.0).detect(
        scene.rgb, scene.intrinsics, gravity_camera=scene.gravity_camera)
    assert found.scale.unit_method == 'relative' and found.ground_result.drop_note
    assert len(found.drops_m) == 0 and not found.ground.any()


def test_depth_that_is_too_wrong_gives_no_drop_and_why():
    terrain = course(kerb, -1, 0.2)
    found = [detect(terrain, noisy(terrain, 0.1, np.random.default_rng(seed)))
             for seed in range(4)]
    assert not any(len(one.drops_m) for one in found)
    # At this noise the floor is .3 m off, the limit, or not seen at all.
    assert sum(bool(one.ground_result.drop_note) for one in found) >= 3
    assert any('m off' in one.ground_result.drop_note for one in found)


@pytest.mark.parametrize('is_indoor', [False, True])
def test_an_indoor_network_under_the_sky_gives_no_drop_and_why(is_indoor):
    scene = course(kerb, -1, 0.2).scene
    rgb, depth_m, sky = scene.rgb.copy(), scene.depth_m.copy(), 120
    rgb[:sky] = np.linspace((160, 195, 245), (225, 235, 245), sky)[:, None]
    depth_m[:sky] = 9.0

    class Network(DepthFunction):
        def predict(self, rgb, intrinsics):
            return replace(super().predict(rgb, intrinsics), is_indoor=is_indoor)

    found = PlaneDetector(Config(), Network(lambda rgb: depth_m)).detect(
        rgb, scene.intrinsics, gravity_camera=scene.gravity_camera)
    assert (len(found.drops_m) == 0) == is_indoor
    assert ('indoors' in found.ground_result.drop_note) == is_indoor


def test_without_gravity_nothing_is_claimed():
    scene = course(kerb, 1).scene
    flat_picture = np.full_like(scene.rgb, 90)  # no lines
    found = PlaneDetector(MEASURED).detect(flat_picture, scene.intrinsics, scene.depth_m)
    assert not found.ground.any() and not any(found.classes)
    assert found.ground_result.drop_note == 'the direction of gravity is not known'
