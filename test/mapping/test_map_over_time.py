# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What a map keeps, forgets and counts over time, and that it is the same in every frame."""

from functools import cache

import numpy as np
import pytest

from plane_detector import Config, PlaneDetector
from plane_detector.config import DepthConfig, MapConfig
from plane_detector.evaluation.benchmark.map import record
from plane_detector.evaluation.scenes.rooms import box, camera_rotation, render
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.mapping.plane_map import PlacedDetection, PlaneMap
from plane_detector.mapping.registration import Correction, predict
from plane_detector.types import CameraIntrinsics, PlaneClass

CAMERA = CameraIntrinsics.from_field_of_view(160, 120, 70.0)
HERE = RigidTransform.identity()
# To the right, where something else is to be seen.
ASIDE = RigidTransform.from_quaternion((0, np.sin(np.pi / 4), 0, np.cos(np.pi / 4)), (0, 0, 0))
BEHIND = RigidTransform.from_quaternion((0, 1, 0, 0), (0, 0, 0))


@cache
def wall(distance_m=2.0):
    depth_m = np.full((CAMERA.height, CAMERA.width), distance_m, np.float32)
    return PlaneDetector(Config(depth=DepthConfig(source='topic'))).detect(
        np.zeros((*depth_m.shape, 3), np.uint8), CAMERA, depth_m)


def add(planes, found, pose, stamp_s=0.0):
    return planes.update(PlacedDetection(found, CAMERA, pose, stamp_s))


def test_what_was_seen_once_stays_for_thirty_images_whenever_that_was():
    planes = PlaneMap()
    for _ in range(40):
        add(planes, wall(), HERE)
    once, = add(planes, wall(1.5), ASIDE).labels
    for k in range(29):
        assert once in [plane.label for plane in planes.planes], f'gone after {k} images'
        add(planes, wall(), HERE)
    for _ in range(3):
        add(planes, wall(), HERE)
    assert [plane.label for plane in planes.planes] == [1]


def test_a_plane_that_is_new_after_loading_has_a_label_of_its_own(tmp_path):
    before = PlaneMap()
    for pose in (HERE, ASIDE, HERE, ASIDE):
        add(before, wall(), pose)
    before.save(tmp_path / 'map.json', 'odom', 1.0)
    after = PlaneMap()
    after.load(tmp_path / 'map.json', 'odom')
    known = {plane.label for plane in after.planes}
    new, = add(after, wall(1.5), BEHIND).labels
    assert len(known) == 2 and new > max(known)


def test_a_loaded_map_is_the_map_that_was_saved(tmp_path):
    before = PlaneMap()
    for k, (found, pose) in enumerate(zip(recording().detections, recording().walked.poses,
                                          strict=True)):
        add(before, found, RigidTransform(pose.rotation, pose.translation_m + [0.01 * k, 0, 0]),
            10.0 + k)
    before.save(tmp_path / 'map.json', 'odom', 1.0)
    after = PlaneMap()
    after.load(tmp_path / 'map.json', 'odom')
    # What no message shows, seen once, is not saved.
    shown = set(before.snapshot().planes.labels.tolist())
    assert len(after.planes) == len(shown) > 3
    for old, new in zip([one for one in before.planes if one.label in shown], after.planes,
                        strict=True):
        assert new.apart == old.apart & shown
        for name in ('label', 'views', 'first_seen_s', 'last_seen_s', 'plane_class'):
            assert getattr(new, name) == getattr(old, name), name
        for name in ('origin_m', 'axes', 'coefficients', 'covariance', 'centroid_m'):
            np.testing.assert_allclose(getattr(new, name), getattr(old, name), atol=1e-9)
        assert (new.cells.seen == old.cells.seen).all()
    off_m = before.correction.transform.translation_m
    assert np.linalg.norm(off_m) > 0.02, 'the poses have drifted'
    assert after.correction.transform.translation_m == pytest.approx(off_m, abs=1e-6)
    # What the camera sees next is found in it again.
    last = recording().walked.poses[-1]
    labels = add(after, recording().detections[-1], RigidTransform(
        last.rotation, last.translation_m + [0.09, 0, 0])).labels
    assert set(labels[labels > 0]) <= {plane.label for plane in before.planes}
    assert (labels > 0).all()


def test_a_map_that_was_cleared_is_a_new_one_but_for_its_labels():
    used, new = PlaneMap(), PlaneMap()
    for k, found in enumerate(recording().detections):
        pose = recording().walked.poses[k]
        add(used, found, RigidTransform(pose.rotation, pose.translation_m + [0.01 * k, 0, 0]))
    known = {plane.label for plane in used.planes}
    used.clear()
    for k, found in enumerate(recording().detections[:4]):
        for planes in (used, new):
            add(planes, found, recording().walked.poses[k])
    assert (used.jitter_m, used.images) == (new.jitter_m, new.images)
    assert used.correction.size() == new.correction.size()
    for one, other in zip(used.planes, new.planes, strict=True):
        assert one.label > max(known)
        assert (one.coefficients == other.coefficients).all()
        assert (one.covariance == other.covariance).all()
        assert one.first_image == other.first_image
    first, second = used.snapshot(), new.snapshot()
    assert (first.planes.covariances == second.planes.covariances).all()


def test_an_error_of_the_pose_moves_with_the_camera():
    """A rotation about where the camera was is, where it is now, a rotation and a shift."""
    before, after = np.array([1.0, -2.0, 0.5]), np.array([1.5, -1.2, 1.1])
    turns, shifts = 0.01 * np.random.default_rng(0).standard_normal((2, 4000, 3))
    moved = shifts + np.cross(turns, after - before)  # to first order
    errors, expected = np.hstack([turns, shifts]), np.hstack([turns, moved])
    pose = RigidTransform(np.eye(3), before)
    correction = Correction(HERE, np.zeros((6, 6)), HERE, errors.T @ errors / len(errors), pose)
    found = predict(correction, RigidTransform(np.eye(3), after),
                    MapConfig(pose_drift=0.0, pose_jitter=0.0))
    np.testing.assert_allclose(found.drift, expected.T @ expected / len(errors), atol=1e-9)


@cache
def recording():
    return record('box', 1, 0.0002, 10, CAMERA)


def test_the_map_is_the_same_in_every_frame_with_z_up():
    """Poses in another frame: all of the map, and its errors, are those of before in it."""
    world = RigidTransform.from_quaternion((0, 0, np.sin(0.9), np.cos(0.9)), (7.0, -3.0, 0.8))
    maps = [PlaneMap(), PlaneMap()]
    drift = RigidTransform.from_quaternion((0.002, -0.003, 0.004, 1), (0.01, -0.02, 0.015))
    for k, found in enumerate(recording().detections):
        pose = recording().walked.poses[k]
        if k >= 5:
            pose = drift.after(pose)
        updates = [add(maps[0], found, pose), add(maps[1], found, world.after(pose))]
        assert (updates[0].labels == updates[1].labels).all()
        assert updates[0].explained == pytest.approx(updates[1].explained)
    first, second = (one.snapshot() for one in maps)
    expected = first.planes.moved(world)
    assert len(expected) > 3
    for name, most_off in (('normals', 1e-6), ('offsets_m', 1e-6), ('covariances', 2e-7),
                           ('centroids_m', 0.04), ('areas_m2', 0.05)):  # a few cells round up
        np.testing.assert_allclose(getattr(second.planes, name), getattr(expected, name),
                                   rtol=1e-4, atol=most_off, err_msg=name)
    sizes = [one.correction.size() for one in maps]
    assert sizes[0] == pytest.approx(sizes[1], rel=1e-5)
    assert sizes[0][0] > 0.01, 'something is corrected'
    for one, snapshot in zip(maps, (first, second), strict=True):
        # The poses see the planes where the last camera did.
        np.testing.assert_allclose(
            snapshot.to_poses.after(one.correction.transform).translation_m, 0, atol=1e-9)


def test_the_map_knows_what_is_up_and_what_is_a_floor():
    """From detections with gravity, in a world whose z points up."""
    planes, labels = PlaneMap(), []
    camera = CameraIntrinsics.from_field_of_view(160, 120, 80.0)
    size_m = np.array([4.0, 5.0, 2.6])
    room = box(size_m / 2, size_m)
    for yaw_deg in (0, 10, 20, 30):
        pose = RigidTransform(camera_rotation(yaw_deg, -25, 5), np.array([2.0, 2.0, 1.3]))
        scene = render(room, pose.rotation, pose.translation_m, camera, np.random.default_rng(0))
        found = PlaneDetector(Config(depth=DepthConfig(source='topic'))).detect(
            scene.rgb, camera, scene.depth_m, -pose.rotation[2])
        labels.append(planes.update(PlacedDetection(found, camera, pose, 0.1 * yaw_deg)).labels)
    assert planes.up == pytest.approx([0, 0, 1], abs=0.02)
    kinds = {plane.label: (plane.plane_class, plane.axes[2]) for plane in planes.planes}
    for kind, normal in kinds.values():
        assert (kind == PlaneClass.FLOOR) == (normal[2] > 0.9)
        assert (kind == PlaneClass.WALL) == (abs(normal[2]) < 0.1)
    assert len(kinds) >= 3
    # A label of an image is that of a plane that is in the map after it.
    assert {label for one in labels[-1:] for label in one.tolist()} <= {0, *kinds}
