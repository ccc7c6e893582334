# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Labels over time: on hand-made planes, in a rendered walk, on real images."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from plane_detector.config import TrackingConfig
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rooms import box, camera_rotation, render
from plane_detector.pipeline import segment_planes
from plane_detector.tracking.camera_motion import PlaneMotion
from plane_detector.tracking.matching import compare, matched
from plane_detector.tracking.tracker import PlaneTracker
from plane_detector.types import CameraIntrinsics, Plane, Planes, PlaneSegmentation

CAMERA = CameraIntrinsics(200.0, 200.0, 159.5, 119.5, 320, 240)
SHAPE = (120, 160)
COVARIANCE = np.diag([1e-6, 1e-6, 1e-6, 1e-6])
FRAME_RATE_HZ = 30.0
WALK_M_S, TURN_DEG_S = 1.2, 45.0


def plane(normal, distance_m, at=(0.0, 0.0, 2.0), area_m2=1.0):
    """Return a plane at a distance from the camera, its centroid near a point."""
    normal = np.asarray(normal, float) / np.linalg.norm(normal)
    centroid_m = np.asarray(at, float)
    centroid_m = centroid_m - (centroid_m @ normal + distance_m) * normal
    return Plane(normal, distance_m, centroid_m, 100, 0.001, area_m2, COVARIANCE, 1.0)


FLOOR = plane([0, -1, 0], 1.4, (0, 1.4, 2))
LEFT = plane([1, 0, 0], 1.5, (-1.5, 0, 2.5))
BACK = plane([0, 0, -1], 4.0, (0, 0, 4))
BOX = plane([0.2, 0, -1], 2.0, (0.5, 0.5, 2), 0.2)
PATCHES = (np.s_[80:, :], np.s_[:80, :60], np.s_[:80, 60:], np.s_[50:90, 90:130])


def image(*planes, patches=PATCHES, shape=SHAPE):
    """Return a segmentation in which each plane fills its patch; later ones lie before."""
    labels = np.full(shape, -1, np.int32)
    for index, patch in enumerate(patches[:len(planes)]):
        labels[patch] = index
    return PlaneSegmentation(Planes.of(planes), labels, 0.001)


ROOM = image(FLOOR, LEFT, BACK, BOX)


class Tracked(PlaneTracker):
    def __init__(self, **settings):
        super().__init__()
        self.settings = TrackingConfig(**settings)

    def update(self, found):
        return super().update(found, self.settings)


def labels_of(tracker, found):
    return tuple(tracker.update(found).planes.labels.tolist())


def test_labels_follow_the_plane_and_not_the_order():
    tracker = Tracked()
    tracker.update(ROOM)
    turned = image(BOX, BACK, FLOOR, LEFT,
                     patches=(PATCHES[3], PATCHES[2], PATCHES[0], PATCHES[1]))
    turned.labels[PATCHES[3]] = 0
    assert labels_of(tracker, turned) == (4, 3, 1, 2)


PERSON = plane([0.3, 0, -1], 0.8, (0, 0, 0.9), 0.4)


@pytest.mark.parametrize('has_plane', [True, False])
@pytest.mark.parametrize('left', [3, 5, 8, 12])
@pytest.mark.parametrize('others', [(), (LEFT,), (LEFT, BOX)])
def test_a_person_close_by_who_hides_most_of_a_plane_takes_no_label(has_plane, left, others):
    """Of a wall of 100 columns some stay in view on either side, with another centroid."""
    tracker = Tracked()
    patches = (np.s_[:80, 60:], np.s_[:80, :60], np.s_[50:90, 90:130])
    room = image(BACK, *others, patches=patches)
    for _ in range(5):
        before = labels_of(tracker, room)
    rest = plane([0, 0.02, -1], 4.02, (3.2 if left < 6 else 2.8, 0.1, 4), left / 100)
    hidden = image(rest, *others, *([PERSON] if has_plane else []),
                   patches=(*patches[:len(others) + 1], np.s_[:, 20:160 - left]))
    if not has_plane:
        hidden.labels[:, 20:160 - left] = -1
    for _ in range(3):
        found = labels_of(tracker, hidden)
        assert found[0] == before[0]
        assert not has_plane or found[-1] not in before
    assert labels_of(tracker, room) == before


def test_a_front_before_a_wall_that_it_hides_is_not_the_wall():
    """Parallel and as large, 15 % nearer; nor does the wall lose its label by it."""
    tracker = Tracked()
    for _ in range(3):
        labels_of(tracker, image(BACK, patches=(np.s_[:80, :],)))
    front = plane([0, 0, -1], 3.4, (0, 0, 3.4))
    assert labels_of(tracker, image(front, BACK, patches=(np.s_[:80, :150], np.s_[:80, 150:]))
                     ) == (2, 1)


def test_a_plane_missed_for_a_while_comes_back_under_its_label():
    tracker = Tracked(keep_frames=5)
    tracker.update(ROOM)
    for _ in range(5):
        assert labels_of(tracker, image(FLOOR, LEFT, BACK)) == (1, 2, 3)
    assert labels_of(tracker, ROOM) == (1, 2, 3, 4)


@pytest.mark.parametrize('missed, label', [(1, 5), (8, 4)])
def test_the_longer_a_plane_was_missed_the_more_it_may_have_changed(missed, label):
    """A door that turned by 35 degrees while it was out of view."""
    tracker = Tracked()
    for _ in range(5):
        tracker.update(ROOM)
    for _ in range(missed):
        tracker.update(image(FLOOR, LEFT, BACK))
    turned = replace(BOX, normal=cv2.Rodrigues(np.radians([0.0, 35.0, 0.0]))[0] @ BOX.normal)
    turned = replace(turned, offset_m=float(-turned.normal @ turned.centroid_m))
    assert labels_of(tracker, image(FLOOR, LEFT, BACK, turned)) == (1, 2, 3, label)


@pytest.mark.parametrize('factor', [0.4, 0.9, 1.3, 5.0])
def test_a_change_of_unit_changes_no_label(factor):
    tracker = Tracked()
    tracker.update(ROOM)
    unit = PlaneMotion(np.eye(3), np.zeros(3), factor)
    assert labels_of(tracker, replace(ROOM, planes=unit.move(ROOM.planes))) == (
        1, 2, 3, 4)


def test_a_rotation_without_shared_pixels_changes_no_label():
    """A slow network sees a turning camera at 20 degrees an image; the small plane moves away."""
    tracker = Tracked()
    tracker.update(ROOM)
    motion = PlaneMotion(cv2.Rodrigues(np.radians([0.0, 20.0, 0.0]))[0],
                         np.array([0.05, 0.0, 0.1]), 1.0)
    moved = image(*motion.move(ROOM.planes),
                    patches=(np.s_[80:, :], np.s_[:80, :90], np.s_[:80, 90:],
                             np.s_[50:90, 132:160]))
    assert labels_of(tracker, moved) == (1, 2, 3, 4)


def test_another_image_size_and_reset_clear_the_tracks():
    tracker = Tracked()
    tracker.update(image(BACK, BOX))
    tracker.update(image(FLOOR, LEFT))
    assert labels_of(tracker, image(FLOOR, LEFT)) == (3, 4)
    assert labels_of(tracker, image(FLOOR, LEFT, shape=(240, 320))) == (1, 2)
    tracker.reset()
    assert labels_of(tracker, image(LEFT, FLOOR, shape=(240, 320))) == (1, 2)


def walk(frame_count):
    """Yield rotation and place of a head that walks, sways and looks around."""
    period_s = 1.5
    for time_s in np.arange(frame_count) / FRAME_RATE_HZ:
        sway = np.sin(2 * np.pi * 1.8 * time_s)
        look = TURN_DEG_S * period_s / (2 * np.pi) * np.sin(2 * np.pi * time_s / period_s)
        place_m = np.array([2.3 + 0.03 * sway, 0.3 + WALK_M_S * time_s, 1.5 + 0.02 * sway])
        yield camera_rotation(look, -20 + 2 * sway, 1.5 * sway), place_m


@pytest.fixture(scope='module')
def walked_room():
    """A furnished room of 5 x 6 m, seen at every step of a walk."""
    size = np.array([5.0, 6.0, 2.6])
    furniture = [((0.9, 4.4, 0.45), (1.0, 1.6, 0.9), 0), ((4.1, 4.2, 0.4), (1.3, 0.9, 0.8), 20),
                 ((3.4, 5.75, 1.0), (1.6, 0.5, 2.0), 0), ((1.3, 5.98, 1.6), (0.9, 0.04, 0.7), 0)]
    rectangles = box(size / 2, size)
    for center, extent, yaw_deg in furniture:
        rectangles += box(np.array(center), np.array(extent), yaw_deg)
    return [render(rectangles, rotation, place, CAMERA, np.random.default_rng(0))
            for rotation, place in walk(45)]


def label_switches(scenes, sigma, every=1):
    """Return for each rectangle in view throughout how often its label changes."""
    tracker, rng = Tracked(), np.random.default_rng(2)
    labels_seen, smallest = {}, {}
    for scene in scenes[::every]:
        depth_m = with_disparity_noise(scene.depth_m, sigma, rng) if sigma else scene.depth_m
        found = tracker.update(segment_planes(depth_m, CAMERA))
        for truth, index in matches(scene, found).items():
            labels_seen.setdefault(truth, []).append(found.planes.labels[index])
        for truth, rectangle in enumerate(scene.rectangles):
            smallest.setdefault(rectangle, []).append((scene.labels == truth).sum())
    least = 0.01 * CAMERA.width * CAMERA.height
    throughout = [r for r, sizes in smallest.items() if r in labels_seen
                  and len(sizes) == len(scenes[::every]) and min(sizes) > least]
    return {r: int(np.count_nonzero(np.diff(labels_seen[r]))) for r in throughout}


def matches(scene, found):
    """Return found plane by rectangle, where it is found whole: their pixels overlap by 0.7."""
    result = {}
    for truth, rectangle in enumerate(scene.rectangles):
        mask = scene.labels == truth
        for index in np.unique(found.labels[mask & (found.labels >= 0)]):
            other = found.labels == index
            if (mask & other).sum() > 0.7 * (mask | other).sum():
                result[int(rectangle)] = int(index)
    return result


@pytest.mark.parametrize('sigma', [0.0, 0.004])
@pytest.mark.parametrize('every', [1, 3])
def test_planes_in_view_keep_their_labels_while_the_camera_walks(walked_room, sigma, every):
    switches = label_switches(walked_room, sigma, every)
    assert len(switches) >= 6
    assert not any(switches.values()), switches


def test_planes_differ_by_the_errors_of_both():
    """Two walls at 4 m, 30 cm apart; the second is known to 20 cm."""
    sure, unsure = (Planes.of([replace(BACK, covariance=np.diag([0, 0, 0, sigma_m**2]),
                                       offset_m=offset_m, centroid_m=np.array([0, 0, offset_m]))])
                    for sigma_m, offset_m in ((0.0, 4.0), (0.2, 4.3)))
    found = compare(sure, unsure, np.ones(1))[0].item()
    assert found == pytest.approx((0.3 / 4.15) ** 2 / (0.03**2 + (0.2 / 4.3) ** 2), rel=0.01)


def test_a_plane_that_may_turn_about_its_centroid_is_as_far_there_as_one_that_may_not():
    """Its offset is -n . c, so that the errors of n and of the offset cancel at the centroid."""
    centroid_m, of_normal = np.array([2.0, 1.0, 4.0]), np.diag([0.1, 0.1, 0.0]) ** 2
    turn = np.vstack([np.eye(3), -centroid_m])  # of the coefficients, by the normal
    unsure = replace(BACK, centroid_m=centroid_m, covariance=turn @ of_normal @ turn.T)
    sure = replace(unsure, covariance=np.zeros((4, 4)), offset_m=4.3)
    found = compare(Planes.of([unsure]), Planes.of([sure]), np.ones(1))[0].item()
    off = 0.3 / np.linalg.norm(centroid_m)
    assert found == pytest.approx(off**2 / 2 / 0.03**2, rel=0.01)
    normal = np.array([np.sin(0.3), 0.0, -np.cos(0.3)])
    turned = replace(sure, normal=normal, offset_m=-normal @ centroid_m)
    found = compare(Planes.of([unsure]), Planes.of([turned]), np.ones(1))[0].item()
    assert found == pytest.approx(0.3**2 / (np.radians(10.0) ** 2 + 2 * 0.1**2))


def test_the_nearness_of_centroids_is_by_the_smaller_size():
    """Planes of 2 and 8 square metres, the centroids 1 m apart."""
    small, large = (Planes.of([replace(BACK, area_m2=area_m2, centroid_m=np.array([x_m, 0, 4]))])
                    for area_m2, x_m in ((2.0, 0.0), (8.0, 1.0)))
    for one, other in ((small, large), (large, small)):
        nearness = compare(one, other, np.ones(1))[1].item()
        assert nearness == pytest.approx(np.exp(-1 / 2) * (2 / 8) ** 0.5)


def test_a_score_that_is_no_number_pairs_nothing_and_ends():
    score = np.array([[np.nan, 0.2], [0.9, np.nan], [np.nan, np.nan]])
    assert matched(score, 0.0).tolist() == [1, 0]
    assert matched(np.full((3, 4), np.nan), 0.0).tolist() == [-1] * 4
