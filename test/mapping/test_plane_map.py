# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The map of planes on short rendered walks with exact truth."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from map_helpers import map_plane

from plane_detector import Config, PlaneDetector
from plane_detector.config import DepthConfig, MapConfig
from plane_detector.evaluation.benchmark.map import along_face, record, score
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rendering import box, camera_rotation, render
from plane_detector.evaluation.scenes.rooms import single_wall
from plane_detector.evaluation.scenes.walks import QVGA, Walk, walk, walls, with_errors
from plane_detector.geometry.projection import depth_to_points
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.mapping import merging, plane_map
from plane_detector.mapping.association import Pairs, assign
from plane_detector.mapping.heights import with_pose_error
from plane_detector.mapping.map_file import SavedMap, write_map
from plane_detector.mapping.map_plane import as_planes
from plane_detector.mapping.merging import merge_touched
from plane_detector.mapping.plane_map import FORGETTING, PlacedDetection, PlaneMap
from plane_detector.types import METRIC, CameraIntrinsics, PlaneClass

CAMERA = CameraIntrinsics.from_field_of_view(160, 120, 70.0)


# Less noise than in the benchmark: at a quarter of its pixels it is as smooth as a lens error.
@cache
def recording(name='box', images=40, variant=''):
    return record(name, 1, 0.0002, images, CAMERA, variant)


def mapped(detections, poses, planes=None):
    """Return the map of detections, one a second, and what each has changed."""
    planes = planes or PlaneMap()
    return planes, [planes.update(PlacedDetection(found, CAMERA, pose, float(k)))
                    for k, (found, pose) in enumerate(zip(detections, poses, strict=True))]


def sideways(*places_m):
    """Return poses that differ in x only."""
    return [RigidTransform(np.eye(3), np.array([x_m, 0.0, 0.0])) for x_m in places_m]


@pytest.mark.parametrize('kind', ['exact', 'drift', 'jitter'])
def test_one_plane_for_one_surface_whatever_the_poses(kind):
    result = score(recording(), kind, 0)
    assert result.found >= result.surfaces - 1
    assert result.pieces <= result.found + 1
    assert result.of_none <= 1
    assert np.median(result.offsets_m) < 0.01
    assert result.jumps == 0


def test_a_jump_is_found_and_the_planes_move_along():
    result = score(recording(), 'jump 30', 0)
    assert result.jumps == 1
    assert result.found >= result.surfaces - 1
    assert result.pieces <= result.found + 1


def test_a_crate_that_went_and_people_who_walk_through_leave_no_planes():
    people = recording('crate', 48, 'people')
    fixed = len(people.walked.surfaces) + len(people.walked.gone)
    assert max(labels.max() for labels in people.labels) >= fixed  # images do show them
    result = score(people, 'exact', 0)
    assert result.of_none == result.left == 0
    assert result.found >= result.surfaces - 1
    # Nor are labels of what has gone kept.
    planes, beside = PlaneMap(), set()
    for k, found in enumerate(people.detections):
        planes.update(PlacedDetection(found, CAMERA, people.walked.poses[k], 0.1 * k))
        beside |= {label for plane in planes.planes for label in plane.apart}
    labels = {plane.label for plane in planes.planes}
    assert beside - labels  # the crate was beside what has stayed
    assert all(plane.apart <= labels for plane in planes.planes)


def run(images=6, still=False, kind='exact'):
    poses = with_errors(recording().walked.poses, kind, np.random.default_rng(0))
    shown = [0 if still else k for k in range(images)]
    return mapped([recording().detections[k] for k in shown], [poses[k] for k in shown])


def test_equal_images_give_equal_maps():
    (first, _), (second, _) = run(), run()
    for one, other in zip(first.planes, second.planes, strict=True):
        assert one.label == other.label
        assert (one.coefficients == other.coefficients).all()
        assert (one.cells.hits == other.cells.hits).all()


def test_a_standing_camera_does_not_become_sure():
    few, many = (run(images, still=True)[0] for images in (2, 40))
    for before, after in zip(few.planes, many.planes, strict=True):
        assert np.diag(after.covariance) == pytest.approx(np.diag(before.covariance), rel=0.2)


def test_what_the_last_image_shows_is_known_better_where_it_is_seen():
    planes, updates = run(12, kind='drift')
    snapshot = planes.snapshot()
    far = with_pose_error(as_planes(snapshot.surfaces), planes.correction.error,
                          planes.correction.camera.translation_m).moved(snapshot.to_poses)
    shown = np.isin(snapshot.planes.labels, updates[-1].labels)
    assert shown.any() and not shown.all()
    middles = np.column_stack([far.centroids_m, np.ones(len(far))])
    ratio = (np.einsum('ki,kij,kj->k', middles, snapshot.planes.covariances, middles)
             / np.einsum('ki,kij,kj->k', middles, far.covariances, middles))
    assert (ratio[shown] < 1).all()
    assert ratio[~shown] == pytest.approx(1.0)


def test_one_image_says_little_of_the_systematic_error_of_the_sensor():
    maps = [mapped([replace(recording().detections[k], systematic_noise=noise * (k == 3))
                    for k in range(5)], recording().walked.poses[:5])[0].planes
            for noise in (0.0, 0.002)]
    for one, other in zip(*maps, strict=True):
        assert (one.covariance == other.covariance).all()


def test_a_systematic_error_does_not_average_out():
    found = replace(recording().detections[0], systematic_noise=0.005)
    # The camera moves enough for each view to count, and sees the same.
    once, often = (mapped([found] * images, sideways(*0.1 * np.arange(images)))[0].planes[0]
                   for images in (1, 20))
    assert np.sqrt(often.covariance[2, 2] / once.covariance[2, 2]) > 0.5


def test_of_many_views_only_the_last_ones_count():
    """A wall before a camera that moves along it; the sum over views with forgetting is 20."""
    noisy_m = 2.0 + np.random.default_rng(0).normal(0, 0.01, (CAMERA.height, CAMERA.width))
    found = replace(PlaneDetector(Config(depth=DepthConfig(source='topic'))).detect(
        np.zeros((*noisy_m.shape, 3), np.uint8), CAMERA, noisy_m.astype(np.float32)),
        systematic_noise=0.0)
    planes, variances = PlaneMap(MapConfig(pose_drift=1e-6, pose_jitter=1e-6)), []
    for pose in sideways(*0.06 * (np.arange(81) % 2)):
        mapped([found], [pose], planes)
        variances.append(planes.planes[0].covariance[2, 2])
    views = variances[0] / np.array(variances)
    assert views[5] == pytest.approx((1 - FORGETTING**6) / (1 - FORGETTING), rel=0.02)
    assert views[80] == pytest.approx(1 / (1 - FORGETTING), rel=0.05)


def test_planes_of_a_network_do_not_move_the_pose_and_are_stated_as_uncertain():
    moved_m, counts, deviations_m = [], [], []
    for is_measured in (True, False):
        planes, rng = PlaneMap(), np.random.default_rng(0)
        for k, found in enumerate(recording().detections):
            # The poses are exact; the scale of each image is off by a tenth.
            scale = float(np.exp(rng.normal(0.0, 0.1)))
            found = replace(found, is_measured=is_measured, depth_m=scale * found.depth_m,
                            planes=found.planes.moved(RigidTransform.identity(), scale))
            planes.update(PlacedDetection(found, CAMERA, recording().walked.poses[k], 0.1 * k))
        moved_m.append(planes.correction.size()[0])
        counts.append(len(planes.planes))
        deviations_m.append(np.median([plane.covariance[2, 2] ** 0.5 for plane in planes.planes]))
    assert moved_m[0] > 0.2 and moved_m[1] < 0.02
    assert counts[1] < 0.7 * counts[0]
    assert deviations_m[0] < 0.02 and deviations_m[1] > 0.2


def test_a_network_is_a_fifth_of_the_distance_off_and_five_degrees_about_the_middle():
    wall_m = single_wall(CAMERA, yaw_deg=40, distance_m=2.0).depth_m
    found = PlaneDetector(depth_model=lambda image: wall_m).detect(
        np.zeros((*wall_m.shape, 3), np.uint8), CAMERA)
    planes, _ = mapped([found], sideways(0.0))
    offset_m, tilt = found.planes[0].offset_m, np.radians(5.0)
    assert np.sqrt(np.diag(planes.planes[0].covariance)) == pytest.approx(
        [tilt, tilt, 0.2 * offset_m], rel=0.02)


def test_a_detection_says_whether_its_depth_is_of_a_sensor():
    wall_m = np.full((CAMERA.height, CAMERA.width), 2.0, np.float32)
    rgb = np.zeros((*wall_m.shape, 3), np.uint8)
    sensor = PlaneDetector(Config(depth=DepthConfig(source='topic')))
    assert sensor.detect(rgb, CAMERA, wall_m).is_measured
    assert not PlaneDetector(depth_model=lambda image: wall_m).detect(rgb, CAMERA).is_measured


def test_a_leaf_before_its_wall_is_another_plane_however_much_the_sensor_bends_them():
    wall_m = np.full((CAMERA.height, CAMERA.width), 2.5, np.float32)
    leaf_m = wall_m.copy()
    leaf_m[30:, 50:110] -= 0.04
    detector = PlaneDetector(Config(depth=DepthConfig(source='topic')))
    rgb = np.zeros((*wall_m.shape, 3), np.uint8)
    bent = [replace(detector.detect(rgb, CAMERA, depth_m), systematic_noise=0.0018)
            for depth_m in (wall_m, wall_m, leaf_m, leaf_m)]
    *_, last = mapped(bent, sideways(0.0, 0.02, 0.04, 0.06))[1]
    assert last.labels.tolist() == [1, 2]


def test_a_wall_is_not_the_picture_that_it_covers():
    # The wall of the map is in view with a little more than what is found of it.
    pairs = Pairs(np.arange(2), np.zeros(2, int), np.ones(2), np.array([1.0, 0.95]),
                  np.array([0.05, 0.9]))
    assert assign(pairs, np.zeros((1, 1), bool), 1).tolist() == [1]


def piece(label, left_m, apart=()):
    """Return a piece of the floor, 1 m x 1 m."""
    return map_plane(label, PlaneClass.FLOOR, (left_m, 0, 0), np.eye(3), np.full((20, 20), 5),
                     variance=1e-4, apart=apart)


@pytest.mark.parametrize('larger, smaller, third, labels', [
    ((), (), (), {1}), ((2,), (), (), {1, 2}), ((), (1,), (), {1, 2}),
    ((), (), (2,), {1, 3})])  # what is not the smaller one is not what that becomes a part of
def test_pieces_of_one_plane_are_merged_unless_an_image_has_shown_them_apart(
        larger, smaller, third, labels):
    planes = [piece(1, 0.0, larger), piece(2, 1.0, smaller)]
    planes += [piece(3, 2.0, third)] if third else []
    merged, gone = merge_touched(planes, np.array([1]), np.array([0.0, 0.0, 1.0]))
    assert {plane.label for plane in merged} == labels
    assert gone == ({} if 2 in labels else {2: 1})
    if gone:
        assert merged[0].cells.area_m2 == pytest.approx(2.0)
        assert merged[-1].apart == ({1} if third else set())


def test_without_metres_there_is_no_map():
    planes, _ = run(1)
    unscaled = replace(recording().detections[0], scale=replace(METRIC, is_metric=False))
    with pytest.raises(ValueError, match='no map without metres'):
        mapped([unscaled], recording().walked.poses[:1], planes)
    assert planes.images == 1


def test_a_plane_whose_normal_is_hardly_known_is_not_added():
    found, pose = recording().detections[0], recording().walked.poses[0]
    covariances = found.planes.covariances.copy()
    covariances[0] += np.diag([0.1**2] * 3 + [0.0])
    unclear = replace(found, planes=replace(found.planes, covariances=covariances))
    (sure, _), (planes, (update,)) = (mapped([one], [pose]) for one in (found, unclear))
    shapes = [[plane.cells.hits.shape for plane in one.planes] for one in (sure, planes)]
    assert update.labels[0] == 0 and (update.labels[1:] > 0).any()
    assert shapes[1] == shapes[0][1:], 'nor do its points enlarge another one'


def test_labels_are_not_used_again_after_clear():
    planes, updates = run(2)
    planes.clear()
    assert planes.planes == ()
    _, (update,) = mapped(recording().detections[:1], recording().walked.poses[:1], planes)
    assert update.labels.min() > updates[-1].labels.max()


def test_labels_of_a_file_are_not_used_again(tmp_path):
    planes, _ = run(2)
    planes.save(tmp_path / 'map.json', 'odom', 0.0)
    other = PlaneMap()
    other.load(tmp_path / 'map.json', 'odom')
    # Far away, where none of them is.
    _, (update,) = mapped(recording().detections[:1], sideways(1000.0), other)
    assert update.labels.min() > max(plane.label for plane in planes.planes)


@pytest.mark.parametrize('images', [0, 3])
def test_an_image_without_planes_changes_nothing(images):
    planes, _ = run(images)
    before = [plane.label for plane in planes.planes]
    blank = PlaneDetector(Config(depth=DepthConfig(source='topic'))).detect(
        np.zeros((120, 160, 3), np.uint8), CAMERA, np.full((120, 160), np.nan, np.float32))
    _, (update,) = mapped([blank], recording().walked.poses[3:4], planes)
    assert update.labels.size == 0
    assert [plane.label for plane in planes.planes] == before
    assert set(planes.snapshot().planes.labels) <= set(before)


def test_both_sides_of_a_thin_panel_are_two_planes():
    rng = np.random.default_rng(0)
    walked = walk('panel', rng, 24)
    detector = PlaneDetector(Config(depth=DepthConfig(source='topic')))
    scenes = [walked.scene(k, CAMERA, rng) for k in range(24)]
    planes, _ = mapped([detector.detect(
        scene.rgb, CAMERA, with_disparity_noise(scene.depth_m, 0.001, rng)) for scene in scenes],
        walked.poses)
    sides = [plane for plane in planes.planes
             if abs(plane.axes[2, 2]) < 0.1 and np.linalg.norm(plane.centroid_m[:2]) < 0.5
             and plane.cells.area_m2 > 0.5]
    assert len(sides) == 2
    assert sides[0].axes[2] @ sides[1].axes[2] < -0.99


def test_a_plane_seen_once_in_a_long_walk_is_forgotten_after_a_load(tmp_path):
    """After as many images as without: those before the file do not count."""
    planes, _ = run(1)
    planes.images = 1000
    planes.planes = tuple(replace(plane, first_image=999) for plane in planes.planes)
    write_map(tmp_path / 'map.json', SavedMap(
        planes.planes, RigidTransform.identity(), 'odom', 0.0), as_planes(planes.planes))
    planes.load(tmp_path / 'map.json', 'odom')
    before = {plane.label for plane in planes.planes}
    mapped([recording().detections[0]] * 31, sideways(*[1000.0] * 31), planes)  # sees none of them
    assert not before & {plane.label for plane in planes.planes}


def test_a_map_whose_cells_are_used_up_grows_no_more_and_says_so(monkeypatch):
    """Room for the first two planes only: the others have no cells, and go."""
    whole, _ = run(1)
    sizes = [plane.cells.hits.size for plane in whole.planes]
    monkeypatch.setattr(plane_map, 'MOST_CELLS_IN_ALL', sum(sizes[:2]))
    planes, updates = run(3)
    assert [update.is_full for update in updates] == [True] * 3
    assert sum(plane.cells.hits.size for plane in planes.planes) <= sum(sizes[:2])
    assert len(planes.planes) == 2


def test_planes_are_not_merged_into_more_cells_than_there_may_be(monkeypatch):
    """Two pieces of the floor 10 m apart: around both there are 220 x 20 cells and a margin."""
    pieces = [piece(1, 0.0), piece(2, 10.0)]
    for most, count in ((228 * 20, 1), (228 * 20 - 1, 2)):
        monkeypatch.setattr(merging, 'MOST_CELLS_IN_ALL', most)
        merged, _ = merge_touched(pieces, np.array([1]), np.array([0.0, 0.0, 1.0]))
        assert len(merged) == count


THINGS = {'crate': box([0, 1.6, 0.3], [0.6, 0.6, 0.6], 20),
          'picture': box([0.3, 2.19, 1.3], [0.9, 0.02, 0.7])}


@pytest.mark.parametrize('was_empty', [True, False])
@pytest.mark.parametrize('name', THINGS)
def test_what_is_taken_away_is_gone_within_twenty_looks(name, was_empty):
    """Also where the wall and the floor behind it were seen before it came."""
    rng, thing, there = np.random.default_rng(1), THINGS[name], range(12, 36)
    room = walls(np.array([4.4, 4.4, 2.5]))
    detector, planes = PlaneDetector(Config(depth=DepthConfig(source='topic'))), PlaneMap()
    for k in range(0 if was_empty else there[0], there[-1] + 21):
        pose = RigidTransform(camera_rotation(12 * np.sin(0.5 * k), -18 + 3 * np.cos(0.7 * k), 0),
                              np.array([0.15 * np.sin(0.4 * k), -0.9, 1.35]))
        scene = render(room + (thing if k in there else []), pose.rotation, pose.translation_m,
                       QVGA, rng)
        found = detector.detect(scene.rgb, QVGA, with_disparity_noise(scene.depth_m, 0.001, rng),
                                scene.gravity_camera)
        planes.update(PlacedDetection(found, QVGA, pose, 0.1 * k))
        if k == there[-1]:
            of_thing = {plane.label for plane in planes.planes
                        if any(covers(face, plane) for face in thing)}
    assert of_thing
    assert not of_thing & {plane.label for plane in planes.planes}
    assert not any(covers(face, plane) for face in thing for plane in planes.planes)


def covers(face, plane):
    """Return whether most cells of a plane are on a rectangle, and not on the wall behind it."""
    along = along_face(face, plane.points(plane.cells.middles_m()))
    sides = [np.linalg.norm(edge) + 0.04 for edge in (face.edge_u, face.edge_v)]
    is_on = ((abs(along[:, 2]) < 0.01) & (along[:, :2] > -0.04).all(axis=1)
             & (along[:, :2] < sides).all(axis=1))
    return is_on.mean() > 0.5


def test_a_second_camera_continues_the_map_of_the_first(tmp_path):
    """A robot that turns by 60 degrees on its way, with a camera ahead and one behind."""
    rng, size, images = np.random.default_rng(7), np.array([6.0, 4.5, 2.6]), 24
    ways = [tuple(RigidTransform(camera_rotation(60 * share + turn_deg, -20.0, 0.0),
                                 np.array([2 * share - 1, 0.3 * share - 0.5, 1.0]))
                  for share in np.linspace(0, 1, images)) for turn_deg in (0.0, 180.0)]
    seen, maps = [], (PlaneMap(), PlaneMap())
    for number, (poses, planes) in enumerate(zip(ways, maps, strict=True)):
        if number:
            maps[0].save(tmp_path / 'front.json', 'odom', 9.0)
            planes.load(tmp_path / 'front.json', 'odom')
        walked = Walk(tuple(walls(size)), poses)
        detector = PlaneDetector(Config(depth=DepthConfig(source='topic')))
        for index in range(images):
            shot = walked.scene(index, QVGA, rng)
            noisy_m = with_disparity_noise(shot.depth_m, 0.001, rng)
            found = detector.detect(shot.rgb, QVGA, noisy_m, gravity_camera=shot.gravity_camera,
                                    stamp_s=0.2 * index)
            planes.update(PlacedDetection(found, QVGA, poses[index], 0.2 * index))
            points_m = poses[index].points(depth_to_points(shot.depth_m, QVGA).reshape(-1, 3))
            on_floor = points_m[abs(points_m[:, 2]) < 1e-3, :2]
            seen.append(np.unique(np.floor(on_floor / 0.05), axis=0))
    (front,), (both,) = ([plane for plane in one.snapshot().planes
                          if plane.plane_class is PlaneClass.FLOOR] for one in maps)
    assert both.label == front.label
    true_m2 = [len(np.unique(np.concatenate(part), axis=0)) * 0.05 ** 2
               for part in (seen[:images], seen)]
    assert true_m2[1] > 1.5 * true_m2[0]
    assert [front.area_m2, both.area_m2] == pytest.approx(true_m2, rel=0.05)
