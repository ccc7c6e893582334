# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Markers: outlines, normals and captions of planes, surfaces of shapes."""

from dataclasses import replace

import numpy as np
import output_scene as scene
import pytest
from ros_helpers import header
from scipy.spatial.transform import Rotation
from visualization_msgs.msg import Marker

from plane_detector.ros.outputs.topics import OUTPUTS
from plane_detector.types import METRIC, NO_PLANES, PlaneClass, Planes, ShapeType

BOTH_FRAMES = pytest.mark.parametrize('to_target', [None, scene.TARGET], ids=['camera', 'target'])


def shown(namespace, to_target=None, **settings):
    """Return the markers of a namespace by id, after what comes first in each message."""
    first, *markers = OUTPUTS['markers'].make(scene.frame(to_target=to_target, **settings)).markers
    assert (first.action, first.ns) == (Marker.DELETEALL, ''), 'nothing old stays'
    assert {m.action for m in markers} == {Marker.ADD}
    assert len({(m.ns, m.id) for m in markers}) == len(markers)
    frames = {m.header.frame_id for m in (first, *markers)}
    assert frames == {header().frame_id if to_target is None else 'map'}
    return {m.id: m for m in markers if m.ns == namespace}


def in_camera(vectors, to_target):
    points_m = np.array([[v.x, v.y, v.z] for v in vectors])
    return points_m if to_target is None else to_target.inverse().points(points_m)


def at(marker):
    return np.array([marker.pose.position.x, marker.pose.position.y, marker.pose.position.z])


def test_one_outline_is_a_closed_strip_without_tiny_parts_and_holes():
    labels = np.full((72, 110), scene.NOTHING)
    labels[5:60, 5:90], labels[65:70, 95:100] = scene.WALL, scene.WALL
    labels[30:36, 40:46] = scene.FLOOR
    marker = shown('outline', found=scene.detection(labels=labels, shapes=()))[7]
    pixels = in_camera(marker.points, None)
    pixels = pixels[:, :2] / pixels[:, 2:] * (80.0, 95.0) + (30.5, 45.25)
    assert marker.type == Marker.LINE_STRIP
    np.testing.assert_allclose(pixels, [(5, 5), (5, 59), (89, 59), (89, 5), (5, 5)], atol=1e-6)


@BOTH_FRAMES
def test_large_outlines_of_a_plane_are_drawn_in_front_of_it(to_target):
    outlines = shown('outline', to_target)
    assert set(outlines) == {7, 3}
    for label, index in ((7, scene.WALL), (3, scene.FLOOR)):
        marker = outlines[label]
        ends_m = in_camera(marker.points, to_target)
        normal, offset_m = scene.EQUATIONS[index]
        lifted_m = ends_m @ normal + offset_m
        assert (lifted_m > 0.004).all() and (lifted_m < 0.04).all()
        pixels = ends_m[:, :2] / ends_m[:, 2:] * (80.0, 95.0) + (30.5, 45.25)
        sides = pixels.reshape(-1, 2, 2)
        # Each corner is an end of two sides, and every border of the plane's pixels is near one.
        assert marker.type == Marker.LINE_LIST
        assert set(np.unique(pixels.round(2), axis=0, return_counts=True)[1]) == {2}
        # The hole behind the ball is too small to be drawn.
        mask = np.isin(scene.depth_and_labels()[1], [index, scene.BALL] if label == 7 else index)
        inside = mask[1:-1, 1:-1] & mask[:-2, 1:-1] & mask[2:, 1:-1] & mask[1:-1, :-2] & (
            mask[1:-1, 2:])
        border = mask.copy()
        border[1:-1, 1:-1] &= ~inside
        v, u = np.nonzero(border)
        share = np.linspace(0, 1, 60)[:, None, None]
        drawn = (sides[:, 0] * (1 - share) + sides[:, 1] * share).reshape(-1, 2)
        distance_px = np.linalg.norm(drawn[None] - np.stack([u, v], -1)[:, None], axis=-1)
        assert np.quantile(distance_px.min(axis=1), 0.99) < 3.5


@BOTH_FRAMES
def test_normals_look_at_the_camera(to_target):
    for label, index in ((7, scene.WALL), (3, scene.FLOOR)):
        tail_m, tip_m = in_camera(shown('normal', to_target)[label].points, to_target)
        np.testing.assert_allclose(tail_m, scene.plane(index).centroid_m, atol=1e-9)
        along_m = tip_m - tail_m
        np.testing.assert_allclose(along_m / np.linalg.norm(along_m), scene.EQUATIONS[index][0],
                                   atol=1e-9)


@BOTH_FRAMES
def test_captions_say_label_class_and_d_in_front_of_their_planes(to_target):
    captions = shown('caption', to_target)
    assert {label: one.text for label, one in captions.items()} == {
        7: '7 wall, d 3.00 m', 3: '3 floor, d 0.60 m'}
    for label, index in ((7, scene.WALL), (3, scene.FLOOR)):
        normal, offset_m = scene.EQUATIONS[index]
        marker = captions[label]
        (at_m,) = in_camera([marker.pose.position], to_target)
        half_width_m = 0.3 * marker.scale.z * len(marker.text)
        for x, y in ((-1, -1), (-1, 1), (1, -1), (1, 1)):  # the corners face the camera
            corner_m = at_m + np.array([x * half_width_m, y * marker.scale.z / 2, 0])
            assert corner_m @ normal + offset_m > 0
        on_plane_m = at_m - (at_m @ normal + offset_m) * normal
        u, v = on_plane_m[:2] / on_plane_m[2] * (80.0, 95.0) + (30.5, 45.25)
        assert scene.depth_and_labels()[1][round(v), round(u)] == index


def test_other_planes_have_captions_too():
    planes = [replace(scene.plane(index), plane_class=kind, area_m2=0.001) for index, kind in (
        (scene.WALL, PlaneClass.OTHER), (scene.FLOOR, PlaneClass.UNKNOWN))]
    captions = shown('caption', found=scene.detection(planes=Planes.of(planes),
                                                      scale=replace(METRIC, is_metric=False)))
    assert [one.text for one in captions.values()] == ['7 other, d 3.00', '3 unknown, d 0.60']
    assert all(one.scale.z < 0.01 for one in captions.values()), 'small planes, small captions'


def test_markers_have_the_colours_of_the_overlay():
    for namespace in ('outline', 'normal', 'shape'):
        for label, marker in shown(namespace).items():
            colour = np.array([marker.color.r, marker.color.g, marker.color.b]) * 255
            np.testing.assert_allclose(colour, scene.frame().colours[label], atol=1e-3)


@BOTH_FRAMES
def test_spheres_and_cylinders(to_target):
    (ball,), axis = scene.detection().shapes, np.array([0.6, 0.0, 0.8])
    pipe = replace(ball, type=ShapeType.CYLINDER, axis=axis, length_m=1.5)
    found = scene.detection(shapes=(ball, replace(pipe, label=2)))
    markers = shown('shape', to_target, found=found)
    sphere, cylinder = markers[32773], markers[32770]
    assert (sphere.type, cylinder.type) == (Marker.SPHERE, Marker.CYLINDER)
    assert sphere.scale.x == sphere.scale.z == pytest.approx(0.2)
    assert (cylinder.scale.x, cylinder.scale.z) == pytest.approx((0.2, 1.5))
    turn = cylinder.pose.orientation
    turned = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).apply([0, 0, 1])
    np.testing.assert_allclose(turned, axis if to_target is None else to_target.rotation @ axis,
                               atol=1e-6)
    (centre_m,) = in_camera([sphere.pose.position], to_target)
    np.testing.assert_allclose(centre_m, ball.position_m, atol=1e-9)


@BOTH_FRAMES
def test_a_cone_is_drawn_where_it_is_seen_and_not_from_its_apex_behind_the_camera(to_target):
    """A cone about the optical axis that widens into the scene; its apex is behind the camera."""
    half_angle_rad, apex_m = 0.2, np.array([0.0, 0.0, -1.0])
    v, u = np.indices((72, 110))
    radius = np.hypot((u - 30.5) / 80.0, (v - 45.25) / 95.0)
    depth_m = np.tan(half_angle_rad) / (radius - np.tan(half_angle_rad))  # |x| = (z + 1) tan
    seen = (depth_m > 0.8) & (depth_m < 2.0)
    labels = np.full(seen.shape, -1, np.int32)
    cone = replace(scene.detection().shapes[0], type=ShapeType.CONE, position_m=apex_m,
                   axis=np.array([0.0, 0.0, 1.0]), radius_m=0.0, half_angle_rad=half_angle_rad,
                   length_m=3.0)
    found = scene.detection(planes=NO_PLANES, labels=labels, depth_m=depth_m.astype(np.float32),
                            shapes=(cone,), shape_labels=np.where(seen, 0, -1))
    marker = shown('shape', to_target, found=found)[scene.BALL_LABEL]
    assert (marker.type, len(marker.points) % 3) == (Marker.TRIANGLE_LIST, 0)
    turn = marker.pose.orientation
    corners_m = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).apply(
        [[p.x, p.y, p.z] for p in marker.points]) + at(marker)
    if to_target is not None:
        corners_m = to_target.inverse().points(corners_m)
    np.testing.assert_allclose(np.hypot(*corners_m[:, :2].T),
                               (corners_m[:, 2] + 1.0) * np.tan(half_angle_rad), atol=1e-6)
    assert corners_m[:, 2].min() == pytest.approx(0.8, abs=0.05)
    assert corners_m[:, 2].max() == pytest.approx(2.0, abs=1e-6)
    assert len(np.unique(corners_m[:, 2].round(3))) == 2
