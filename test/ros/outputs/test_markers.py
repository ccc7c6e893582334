# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Markers of planes: outlines, arrows, and captions that do not cover each other."""

from dataclasses import replace

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from ros_helpers import header
from visualization_msgs.msg import MarkerArray

from plane_detector.geometry.label_places import label_places
from plane_detector.planes.classification import PlaneClass
from plane_detector.planes.outline import plane_polygons
from plane_detector.ros.outputs.captions import plane_captions
from plane_detector.ros.outputs.cdr import serialised_markers
from plane_detector.ros.outputs.markers import scene_markers
from plane_detector.types import CameraIntrinsics, Detection, Plane

CAMERA = CameraIntrinsics(100.0, 100.0, 49.5, 39.5, 100, 80)
WALL = Plane(np.array([0.0, 0.0, -1.0]), 2.0, np.array([0.1, 0.0, 2.0]), 2500, 0.0, 1.0,
             np.eye(4), 1.0)


def detection(**changes):
    labels = np.full((80, 100), -1, np.int32)
    labels[10:60, 10:60] = 0
    return replace(Detection((WALL,), labels, 0.0, np.full((80, 100), 2.0, np.float32), 'metric'),
                   **changes)


def markers(shown=(), lifetime_s=0.0, **changes):
    found = detection(**changes)
    polygons = [plane_polygons(found.labels == index, found.depth_m, CAMERA, plane)
                for index, plane in enumerate(found.planes)]
    labels = found.track_labels or range(1, len(found.planes) + 1)
    lookup = np.array([0, *labels])
    captions = plane_captions(found, labels, CAMERA, label_places(lookup[found.labels + 1]))
    written = serialised_markers(
        header(1.0), scene_markers(found, polygons, captions, shown), lifetime_s)
    return deserialize_message(written, MarkerArray).markers


def shown_captions(first, second, columns):
    """Return the captions shown of two planes side by side, each this wide."""
    labels = np.full((80, 100), -1, np.int32)
    labels[10:60, 10:10 + columns], labels[10:60, 10 + columns:10 + 2 * columns] = 0, 1
    found = markers(planes=(first, second), labels=labels)
    return [m.text for m in found if m.ns == 'caption' and m.action == m.ADD]


def test_of_two_captions_that_would_overlap_that_of_the_larger_plane_is_shown():
    small = replace(WALL, inlier_count=900)
    assert shown_captions(small, WALL, 40) == ['1: 2.00 m', '2: 2.00 m']
    assert shown_captions(small, WALL, 4) == ['2: 2.00 m']


def test_a_caption_is_in_front_of_the_widest_place_of_its_plane():
    """The arms of an L are narrow, and its centroid is off it; the left end of a wall is near."""
    labels = np.full((80, 100), -1, np.int32)
    labels[4:76, 4:12] = labels[60:76, 4:96] = 0
    slanted = replace(WALL, normal=np.array([0.6, 0.0, -0.8]), offset_m=1.6)
    caption = markers(planes=(slanted,), labels=labels)[2]
    at = np.array([caption.pose.position.x, caption.pose.position.y, caption.pose.position.z])
    column, row = at[:2] / at[2] * 100 + (49.5, 39.5)
    assert 60 <= row <= 76 and 4 <= column <= 96
    half_m = 0.6 * len(caption.text) * caption.scale.z / 2
    for end_m in (at - [half_m, 0, 0], at + [half_m, 0, 0]):
        assert end_m @ slanted.normal + slanted.offset_m > 0, 'on the side of the camera'


def test_a_caption_that_is_not_shown_can_still_be_listed():
    texts = [m.text for m in markers(planes=(replace(WALL, inlier_count=79),))
             if m.type == m.TEXT_VIEW_FACING]
    assert texts == ['1: 2.00 m']


def test_a_plane_of_one_pixel_has_no_outline():
    labels = np.full((80, 100), -1, np.int32)
    labels[5, 7] = 0
    outline, normal, _ = markers(labels=labels, shown={1})
    assert (outline.action, normal.action) == (outline.DELETE, outline.ADD)


def test_markers_of_a_plane():
    outline, normal, caption = markers(lifetime_s=1.5, track_labels=(7,))
    assert [m.ns for m in (outline, normal, caption)] == ['outline', 'normal', 'caption']
    assert {m.id for m in (outline, normal, caption)} == {7}
    assert {m.header.frame_id for m in (outline, normal, caption)} == {header().frame_id}
    assert (outline.lifetime.sec, outline.lifetime.nanosec) == (1, 500_000_000)
    assert outline.type == outline.LINE_STRIP
    assert outline.points[0] == outline.points[-1]
    assert len(outline.points) == 5
    tail, tip = normal.points
    assert (tail.x, tail.z) == (0.1, 2.0)
    assert tip.z < tail.z, 'it looks at the camera'
    assert all(m.color.a == 1.0 and m.pose.orientation.w == 1.0 for m in (outline, normal))


def test_captions():
    assert markers()[2].text == '1: 2.00 m'
    assert markers(classes=(PlaneClass.WALL,))[2].text == '1: wall 2.00 m'
    assert markers(classes=(PlaneClass.OTHER_HORIZONTAL,))[2].text == '1: other horizontal 2.00 m'
    assert markers(scale_method='relative')[2].text == '1: 2.00'


def test_a_small_plane_has_no_caption_and_no_text_is_larger_than_its_plane():
    small = markers(planes=(replace(WALL, inlier_count=79),))
    assert [m.action for m in small] == [small[0].ADD, small[0].ADD, small[0].DELETE]
    shelf = markers(planes=(replace(WALL, area_m2=0.01),))
    assert shelf[2].scale.z == pytest.approx(0.2 * 0.1, rel=0.03), 'a little nearer and smaller'
    assert markers()[2].scale.z < 0.07, 'not as tall as a chair'


def test_only_markers_of_lost_planes_are_deleted():
    deleted = [(m.ns, m.id) for m in markers(shown={1, 4}) if m.action == m.DELETE]
    assert deleted == [('outline', 4), ('normal', 4), ('caption', 4)]
