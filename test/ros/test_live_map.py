# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What the map of a node says of its poses, and which click it answers."""

import numpy as np
import pytest
from ros_helpers import header

from plane_detector.config import Config, DepthConfig, MapConfig, NodeConfig
from plane_detector.evaluation.scenes.rooms import box, camera_rotation, render
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.pipeline import PlaneDetector
from plane_detector.ros.live_map import LiveMap
from plane_detector.ros.outputs.frame import DetectedFrame
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics.from_field_of_view(160, 120, 70.0)
SIZE_M = np.array([4.0, 5.0, 2.5])
# Into a corner: floor and two walls hold every direction.
POSE = RigidTransform(camera_rotation(35, -25, 0), np.array([2.0, 2.5, 1.4]))


@pytest.fixture(scope='module')
def found():
    """Return the detection of a corner of a room."""
    scene = render(box(SIZE_M / 2, SIZE_M), POSE.rotation, POSE.translation_m, CAMERA,
                   np.random.default_rng(0))
    detection = PlaneDetector(Config(depth=DepthConfig(source='topic'))).detect(
        scene.rgb, CAMERA, scene.depth_m, scene.gravity_camera)
    assert len(detection.planes) >= 3
    return detection


class Stream:
    """Adds the same image to a map at one stated pose after another."""

    def __init__(self, found, **settings):
        self.map, self._found, self._stamp_s = LiveMap(MapConfig(**settings), 'odom'), found, 0.0

    def add(self, shift_m=(0, 0, 0), epoch=0):
        self._stamp_s += 0.1
        pose = RigidTransform(POSE.rotation, POSE.translation_m + shift_m)
        return self.map.add(DetectedFrame(
            self._found, CAMERA, pose, self._stamp_s, header=header(self._stamp_s),
            rgb=np.zeros((120, 160, 3), np.uint8), settings=NodeConfig(target_frame='odom')),
            epoch)


def test_poses_that_are_good_are_no_problem(found):
    stream = Stream(found)
    for k in range(20):
        stream.add((0.002 * (-1)**k, 0, 0))
    assert stream.map.problem() == ''
    assert stream.map.facts()['map_planes'] == str(len(found.planes))


def test_poses_that_jitter_more_than_stated_are_reported(found):
    stream, rng = Stream(found), np.random.default_rng(0)
    for _ in range(40):
        stream.add(rng.normal(0, 0.012, 3))
    assert 'the poses jitter by' in stream.map.problem()
    jitter_cm = float(stream.map.problem().split('jitter by ')[1].split()[0])
    assert 0.6 < jitter_cm < 2.4


def test_a_map_of_poses_that_are_fixed_to_the_camera_asks_whether_they_are(found):
    """Only if they hardly ever change; and only then."""
    fixed, driven = Stream(found), Stream(found)
    for k in range(70):
        fixed.add((0.3 * (k > 30), 0, 0))
        driven.add((0.01 * k, 0, 0))
    for stream, is_asked in ((driven, False), (fixed, True)):
        if 'corrects the poses' in stream.map.problem():
            assert ('does odom move with the camera' in stream.map.problem()) == is_asked
    assert 'corrects the poses' in driven.map.problem()


def test_poses_that_run_away_are_reported_with_the_way(found):
    stream = Stream(found)
    for k in range(31):  # a drift of a centimetre an image while the camera stands
        stream.add((0.01 * k, 0, 0))
    assert 'corrects the poses by 30 cm' in stream.map.problem()


def test_after_a_jump_back_in_time_the_same_surfaces_keep_their_labels(found):
    """The poses of a bag that starts again may be off by as much as after a jump: no jump."""
    stream = Stream(found)
    for _ in range(3):
        stream.add()
    before = stream.map.take_view().snapshot
    stream.add((0.06, -0.07, 0.05), epoch=1)
    after = stream.map.take_view().snapshot
    assert after.planes.labels.tolist() == before.planes.labels.tolist()
    assert stream.map.take_events() == []
    # The camera has not moved in the room: it still sees the planes where they were.
    assert after.to_poses.translation_m == pytest.approx([0.06, -0.07, 0.05], abs=5e-3)


@pytest.mark.parametrize(('off_m', 'is_answered'), [(0.0, True), (0.05, True), (0.3, False)])
def test_a_click_is_answered_on_a_surface_and_not_in_the_air(found, off_m, is_answered):
    stream = Stream(found)
    for _ in range(2):
        stream.add()
    plane = found.planes[0]
    # Poses that have drifted since: the click is in their frame, as the camera is.
    for k in range(1, 6):
        stream.add((0.03 * k, -0.04 * k, 0.02 * k))
    shift_m = np.array([0.15, -0.2, 0.1])
    point_m = POSE.points(plane.centroid_m + off_m * plane.normal) + shift_m
    if not is_answered:
        with pytest.raises(ValueError, match='there is no plane'):
            stream.map.plane_at(point_m)
        return
    row, kept = stream.map.plane_at(point_m)
    assert row.normals[0] @ POSE.rotation @ plane.normal > 0.999
    assert row.labels.tolist() == [kept.label]
    assert (POSE.points(plane.centroid_m) + shift_m) @ row.normals[0] + row.offsets_m[0] == (
        pytest.approx(0, abs=0.03))
