# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Every output but the markers, read as a subscriber does, beside plain numpy."""

import json
from dataclasses import replace

import cv2
import numpy as np
import output_scene as scene
import pytest
from numpy.lib.recfunctions import repack_fields
from ros_helpers import FRAME_ID, cloud_array, header, image_array
from scipy.spatial.transform import Rotation

from plane_detector.drawing import label_colours, plane_colours
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.planes.plane_table import FIRST, PLANE_DTYPE
from plane_detector.ros.outputs.grid import grid_to_msg
from plane_detector.ros.outputs.map_messages import MAP_PLANE_DTYPE
from plane_detector.ros.outputs.messages import cloud_msg, read_cloud
from plane_detector.ros.outputs.plane_json import planes_to_json
from plane_detector.ros.outputs.topics import OUTPUTS
from plane_detector.types import (
    METRIC,
    NO_PLANES,
    Detection,
    Gravity,
    GroundLack,
    GroundResult,
    PlaneClass,
    ShapeType,
)

BOTH_FRAMES = pytest.mark.parametrize('to_target', [None, scene.TARGET], ids=['camera', 'target'])
PIXEL_LABELS = np.vectorize(scene.MESSAGE_LABELS.get)(scene.depth_and_labels()[1])


def make(name, **settings):
    return OUTPUTS[name].make(scene.frame(**settings))


def moved(points_m, to_target):
    if to_target is None:
        return points_m
    return points_m @ to_target.rotation.T + to_target.translation_m


def xyz(table, prefix=''):
    return np.stack([table[f'{prefix}{axis}'] for axis in 'xyz'], axis=-1)


def packed_colours(table):
    bits = np.ascontiguousarray(table['rgb']).view(np.uint32)
    return np.stack([bits >> 16, bits >> 8 & 255, bits & 255], axis=-1)


def has_frame_of(msg, to_target):
    return msg.header == header(1.5) if to_target is None else (
        msg.header.stamp == header(1.5).stamp and msg.header.frame_id == 'map')


@BOTH_FRAMES
@pytest.mark.parametrize('step', [1, 3])
def test_points(to_target, step):
    msg = make('points', to_target=to_target, points_decimation=step)
    cloud = cloud_array(msg)
    assert [field.name for field in msg.fields] == ['x', 'y', 'z', 'rgb', 'label']
    assert has_frame_of(msg, to_target) and not msg.is_dense
    kept = (slice(None, None, step),) * 2
    np.testing.assert_allclose(xyz(cloud), moved(scene.points(), to_target)[kept], atol=2e-6)
    np.testing.assert_array_equal(cloud['label'], PIXEL_LABELS[kept])
    np.testing.assert_array_equal(packed_colours(cloud), scene.frame().rgb[kept])
    assert read_cloud(msg).tobytes() == cloud.tobytes()


def test_points_have_the_colours_of_their_planes_or_these_mixed_with_the_image():
    rgb, is_found = scene.frame().rgb.astype(float), PIXEL_LABELS[..., None] > 0
    of_label = scene.frame().colours[PIXEL_LABELS].astype(float)
    by_label = packed_colours(cloud_array(make('points', points_color='label')))
    np.testing.assert_array_equal(by_label, np.where(is_found, of_label, 0))
    mixed = packed_colours(cloud_array(make('points', points_color='overlay')))
    expected = np.where(is_found, 0.55 * of_label + 0.45 * rgb, rgb)
    np.testing.assert_allclose(mixed.astype(float), expected, atol=1.01)


@BOTH_FRAMES
@pytest.mark.parametrize('step', [1, 3])
def test_points_without_floor(to_target, step):
    msg = make('points_without_floor', to_target=to_target, points_decimation=step)
    kept = (slice(None, None, step),) * 2
    all_m, labels = scene.points()[kept], scene.depth_and_labels()[1]
    is_obstacle = ((labels != scene.FLOOR) & (labels != scene.BALL))[kept]
    is_obstacle &= np.isfinite(all_m[..., 2])
    expected_m = moved(all_m[is_obstacle], to_target)
    assert (msg.height, msg.width, msg.is_dense) == (1, len(expected_m), True)
    assert has_frame_of(msg, to_target)
    (table,) = cloud_array(msg)
    assert table.dtype.names == ('x', 'y', 'z', 'height', 'sigma')
    np.testing.assert_allclose(xyz(table), expected_m, atol=2e-6)
    heights = np.arange(labels.size).reshape(labels.shape)[kept][is_obstacle]
    np.testing.assert_array_equal(table['height'], heights)
    np.testing.assert_array_equal(table['sigma'], heights / 8)


def test_obstacles_need_no_plane_but_gravity_and_the_unit():
    alone = scene.detection(planes=NO_PLANES)
    assert make('points_without_floor', found=alone).width > 0
    unknown = replace(alone, ground_result=GroundResult(GroundLack.UNIT))
    assert make('points_without_floor', found=unknown) is None
    assert make('ground', found=unknown) is None


@BOTH_FRAMES
def test_ground_and_drops(to_target):
    all_m, is_floor = scene.points(), scene.depth_and_labels()[1] == scene.FLOOR
    msg = make('ground', to_target=to_target)
    assert has_frame_of(msg, to_target)
    np.testing.assert_allclose(xyz(cloud_array(msg)[0]), moved(
        all_m[np.isfinite(all_m[..., 2]) & is_floor], to_target), atol=2e-6)
    msg = make('drops', to_target=to_target)
    (table,) = cloud_array(msg)
    assert has_frame_of(msg, to_target) and table.dtype.names == ('x', 'y', 'z', 'drop')
    np.testing.assert_allclose(xyz(table), moved(scene.detection().drops_m, to_target), atol=1e-6)
    np.testing.assert_array_equal(table['drop'], np.float32([0.25, np.nan]))
    silent = replace(scene.detection().ground_result, drop_note='why')
    assert make('drops', found=scene.detection(ground_result=silent)) is None


def test_the_grid_is_level_below_the_camera_or_in_a_frame_of_the_robot():
    """A floor .6 m below a level camera, before a wall and a pole."""
    gravity = np.array([0.0, 1.0, 0.0])
    pixels = scene.detection().ground_result
    found = scene.detection(gravity=Gravity(gravity, 1.0, 'imu'), ground_result=replace(
        pixels, camera_height_m=0.6,
        heights_m=np.where(pixels.obstacles, np.float32(0.5), np.float32(0))))
    msg = make('grid', found=found)
    cells = np.reshape(msg.data, (msg.info.height, msg.info.width))
    assert msg.header.frame_id == FRAME_ID and msg.info.resolution == pytest.approx(0.05)
    assert msg.info.width * msg.info.resolution == pytest.approx(10.0)
    place, turn = msg.info.origin.position, msg.info.origin.orientation
    corner = RigidTransform.from_quaternion((turn.x, turn.y, turn.z, turn.w),
                                            (place.x, place.y, place.z))
    all_m, labels = scene.points(), scene.depth_and_labels()[1]
    for kind, value in ((scene.FLOOR, 0), (scene.WALL, 100)):
        of_kind = corner.inverse().points(all_m[(labels == kind) & (all_m[..., 2] < 4.5)])
        if kind == scene.FLOOR:
            np.testing.assert_allclose(of_kind[:, 2], 0, atol=1e-5)
        column, row = (of_kind[:, :2] / 0.05).astype(int).T
        assert (cells[row, column] == value).mean() > 0.8
    base = RigidTransform(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.array([0.3, 0, 0.6]))
    of_base = grid_to_msg(replace(scene.frame(found), to_base=base, settings=replace(
        scene.frame(found).settings, base_frame='base_footprint')))
    assert of_base.header.frame_id == 'base_footprint'
    assert (of_base.info.origin.position.x, of_base.info.origin.orientation.w) == (-5.0, 1.0)
    shifted = np.reshape(of_base.data, cells.shape)[:, 6:]  # the base is .3 m behind the camera
    np.testing.assert_array_equal(shifted, cells[:, :-6])
    # In odom the base is at (2.03, -7.11) and looks along y; the grid is along the axes of odom.
    odom = RigidTransform(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
                          np.array([2.03, -7.11, 0.0]))
    in_odom = replace(scene.frame(found), to_base=base, pose=odom.after(base), settings=replace(
        scene.frame(found).settings, base_frame='base_footprint', target_frame='odom'))
    of_odom = grid_to_msg(in_odom)
    assert of_odom.header.frame_id == 'odom' and of_odom.info.origin.orientation.w == 1.0
    place = of_odom.info.origin.position
    assert (place.x, place.y, place.z) == pytest.approx((2.05 - 5.0, -7.1 - 5.0, 0.0))
    cells = np.reshape(of_odom.data, cells.shape)
    for kind, value in ((scene.FLOOR, 0), (scene.WALL, 100)):
        of_kind = odom.after(base).points(all_m[(labels == kind) & (all_m[..., 2] < 4.0)])
        column, row = ((of_kind[:, :2] - (place.x, place.y)) / 0.05).astype(int).T
        assert (cells[row, column] == value).mean() > 0.8
    # An optical frame as target, its z ahead, has no grid from above: it stays in the base frame.
    lying = replace(in_odom, pose=RigidTransform(np.eye(3), np.array([0.1, 0.0, 0.0])))
    assert grid_to_msg(lying).header.frame_id == 'base_footprint'
    silent = replace(found.ground_result, drop_note='why')
    assert make('grid', found=replace(found, ground_result=silent)) is None
    assert make('grid', found=replace(found, ground_result=GroundResult(GroundLack.UNIT))) is None


@BOTH_FRAMES
def test_planes(to_target):
    msg = make('planes', to_target=to_target)
    (table,) = cloud_array(msg)
    assert has_frame_of(msg, to_target)
    for name, values in (('label', scene.TRACKS), ('class', (3, 1)), ('merged', (0, 4)),
                         ('rms', 0.003), ('area', 2.5), ('confidence', 0.75)):
        np.testing.assert_allclose(table[name], values)
    labels = scene.depth_and_labels()[1]
    for index, row in enumerate(table):
        own_m = moved(scene.points()[labels == index], to_target)
        assert row['num_inliers'] == len(own_m)
        np.testing.assert_allclose(xyz(row), own_m.mean(axis=0), atol=1e-5)
        assert abs(own_m @ xyz(row, 'normal_') + row['d']).max() < 1e-5
        camera_m = moved(np.zeros(3), to_target)
        assert camera_m @ xyz(row, 'normal_') + row['d'] > 0, 'the normal points to the camera'
        axes = Rotation.from_quat([row[f'rect_q{axis}'] for axis in 'xyzw']).as_matrix()
        np.testing.assert_allclose(axes[:, 2], xyz(row, 'normal_'), atol=1e-6)
        flat_m = (own_m - xyz(row, 'rect_')) @ axes
        sides_m = np.array([row['rect_width'], row['rect_height'], 0.0])
        assert sides_m[0] >= sides_m[1]
        # The outline is simplified to 2 pixels, which are 14 cm where the wall is farthest.
        np.testing.assert_allclose(np.abs(flat_m).max(axis=0), sides_m / 2, atol=0.15)


@BOTH_FRAMES
def test_boundaries(to_target):
    """The outlines drawn into the image are the planes' pixels: all parts, without the holes."""
    msg = make('boundaries', to_target=to_target)
    (table,) = cloud_array(msg)
    assert has_frame_of(msg, to_target)
    in_camera = None if to_target is None else to_target.inverse()
    parts = {}
    for label, index in ((7, scene.WALL), (3, scene.FLOOR)):
        drawn = np.zeros((scene.CAMERA.height, scene.CAMERA.width), np.uint8)
        of_plane = table[table['label'] == label]
        for number in np.unique(of_plane['polygon']):
            corners = of_plane[of_plane['polygon'] == number]
            assert xyz(corners[0]).tolist() == xyz(corners[-1]).tolist(), 'closed'
            corners_m = moved(xyz(corners), in_camera)
            normal, offset_m = scene.EQUATIONS[index]
            assert abs(corners_m @ normal + offset_m).max() < 1e-5, 'on the plane'
            pixels = corners_m[:, :2] / corners_m[:, 2:] * (80.0, 95.0) + (30.5, 45.25)
            hole = bool(corners['hole'][0])
            cv2.fillPoly(drawn, [np.round(pixels).astype(np.int32)], 0 if hole else 1)
            parts.setdefault(label, []).append(hole)
        mask = scene.depth_and_labels()[1] == index
        assert (drawn == mask).sum() > 0.96 * mask.size
    assert sorted(parts[7]) == [False, False, True, True], 'beside the pole; window and ball'
    assert parts[3] == [False, False]


@BOTH_FRAMES
def test_plane_poses(to_target):
    msg = make('plane_poses', to_target=to_target)
    (table,) = cloud_array(make('planes', to_target=to_target))
    assert has_frame_of(msg, to_target) and len(msg.poses) == 2
    for pose, row in zip(msg.poses, table, strict=True):
        at, turn = pose.position, pose.orientation
        np.testing.assert_allclose([at.x, at.y, at.z], xyz(row), atol=1e-6)
        axes = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
        np.testing.assert_allclose(axes[:, 2], xyz(row, 'normal_'), atol=1e-6)


@BOTH_FRAMES
def test_the_images_stay_in_the_frame_of_the_camera(to_target):
    labels = make('labels', to_target=to_target)
    assert (labels.encoding, labels.step, labels.header) == ('16UC1', 220, header(1.5))
    np.testing.assert_array_equal(image_array(labels, '<u2')[..., 0], PIXEL_LABELS)
    depth = make('depth', to_target=to_target)
    assert (depth.encoding, depth.step, depth.header) == ('32FC1', 440, header(1.5))
    np.testing.assert_array_equal(image_array(depth, '<f4')[..., 0], scene.depth_and_labels()[0])


def test_the_colour_of_a_plane_is_that_of_its_class_and_of_a_shape_that_of_its_label():
    colours = scene.frame().colours
    np.testing.assert_array_equal(colours[list(scene.TRACKS)],
                                  plane_colours(scene.TRACKS, scene.CLASSES))
    np.testing.assert_array_equal(colours[scene.BALL_LABEL], label_colours(scene.BALL_LABEL))


def test_overlay():
    msg = make('overlay')
    assert (msg.encoding, msg.step, msg.header) == ('rgb8', 330, header(1.5))
    drawn, rgb = image_array(msg, 'u1', 3).astype(float), scene.frame().rgb.astype(float)
    mixed = 0.45 * rgb + 0.55 * scene.frame().colours[PIXEL_LABELS]
    expected = np.where(PIXEL_LABELS[..., None] > 0, mixed, rgb)
    wrong = np.abs(drawn - expected).max(axis=-1) > 1.01
    assert 0.03 < wrong.mean() < 0.2, 'only the outlines and the numbers'
    border = PIXEL_LABELS[:, :-1] != PIXEL_LABELS[:, 1:]
    assert wrong[:, :-1][border].all()


def test_the_compressed_overlay_is_the_overlay():
    msg = make('overlay/compressed')
    assert msg.format == 'rgb8; jpeg compressed bgr8'
    bgr = cv2.imdecode(np.frombuffer(msg.data, np.uint8), cv2.IMREAD_COLOR)
    drawn = image_array(make('overlay'), 'u1', 3).astype(float)
    assert np.abs(bgr[..., ::-1] - drawn).mean() < np.abs(bgr - drawn).mean()
    assert np.abs(bgr[..., ::-1].mean(axis=(0, 1)) - drawn.mean(axis=(0, 1))).max() < 3


def test_camera_info():
    msg = make('camera_info')
    assert (msg.width, msg.height, msg.header) == (110, 72, header(1.5))
    assert msg.k.tolist() == [80, 0, 30.5, 0, 95, 45.25, 0, 0, 1]
    assert msg.p.tolist() == [80, 0, 30.5, 0, 0, 95, 45.25, 0, 0, 0, 1, 0]
    assert msg.r.tolist() == np.eye(3).ravel().tolist()
    assert (msg.distortion_model, list(msg.d)) == ('plumb_bob', [0] * 5)


@BOTH_FRAMES
def test_shapes(to_target):
    (ball,), axis = scene.detection().shapes, np.array([0.6, 0.0, 0.8])
    cone = replace(ball, type=ShapeType.CONE, axis=axis, radius_m=0.0, half_angle_rad=0.4,
                   length_m=0.9)
    msg = make('shapes', to_target=to_target,
               found=scene.detection(shapes=(ball, replace(cone, label=2))))
    (table,) = cloud_array(msg)
    assert has_frame_of(msg, to_target)
    for name, values in (('type', (1, 3)), ('label', (32773, 32770)), ('radius', (0.1, 0.0)),
                         ('half_angle', (0.0, 0.4)), ('length', (0.0, 0.9)), ('rms', 0.01),
                         ('num_inliers', 100), ('confidence', 0.8)):
        np.testing.assert_allclose(table[name], values, rtol=1e-6)
    np.testing.assert_allclose(xyz(table), moved(ball.position_m, to_target) * np.ones((2, 1)),
                               atol=1e-6)
    turned = axis if to_target is None else to_target.rotation @ axis
    np.testing.assert_allclose(xyz(table, 'axis_'), [np.zeros(3), turned], atol=1e-6)


def test_no_cloud_says_that_there_are_no_shapes_where_none_were_searched_for():
    assert make('shapes', found=scene.detection(shape_note='shapes.types is none')) is None


def test_the_pixels_of_each_shape_have_its_label():
    ball, = scene.detection().shapes
    shape_labels = scene.detection().shape_labels.copy()
    shape_labels[2:6, 2:8], shape_labels[60:64, 90:99] = 1, 2
    found = scene.detection(shapes=tuple(replace(ball, label=label) for label in (5, 2, 9)),
                            shape_labels=shape_labels)
    labels = image_array(make('labels', found=found), '<u2')
    for k, label in enumerate((5, 2, 9)):
        assert (labels[shape_labels == k] == 32768 + label).all()


def test_without_a_plane_the_clouds_are_empty_and_have_their_fields():
    depth_m, labels = scene.depth_and_labels()
    nothing = Detection(NO_PLANES, np.full_like(labels, -1), 0.0, depth_m, METRIC)
    for name in ('planes', 'boundaries', 'shapes'):
        msg = make(name, found=nothing)
        assert (msg.height, msg.width, len(msg.data)) == (1, 0, 0)
        assert len(msg.fields) == len(make(name).fields)
    assert make('plane_poses', found=nothing).poses == []
    assert not image_array(make('labels', found=nothing), '<u2').any()
    assert not cloud_array(make('points', found=nothing))['label'].any()


def test_the_units_of_json_are_null_without_metres():
    for method, length, area in (('metric', 'm', 'm^2'), ('relative', None, None)):
        units = json.loads(make('planes_json', found=scene.detection(
            scale=replace(METRIC, is_metric=method == 'metric'))).data)['units']
        assert {units[name] for name in ('d', 'centroid', 'width', 'height', 'rms')} == {length}
        assert (units['area'], units['num_inliers']) == (area, 'px')


def test_planes_as_json():
    found = json.loads(OUTPUTS['planes_json'].make(scene.frame()).data)['planes']
    rows = cloud_array(OUTPUTS['planes'].make(scene.frame()))[0]
    for plane, row in zip(found, rows, strict=True):
        assert plane['class'] == PlaneClass(row['class']).readable
        for names, fields in (('label num_inliers d rms area confidence', ''),
                              ('width height', 'rect_')):
            for name in names.split():
                assert plane[name] == pytest.approx(float(row[fields + name]), abs=1e-4), name
        assert plane['normal'] == pytest.approx([float(row[f'normal_{a}']) for a in 'xyz'],
                                                abs=1e-4)
        assert plane['centroid'] == pytest.approx([float(row[a]) for a in 'xyz'], abs=1e-4)


def test_planes_of_a_bag_of_an_earlier_version_are_json_without_what_it_lacks():
    rows, old = cloud_array(make('planes'))[0], [*FIRST]
    msg = cloud_msg(header(1.5), np.dtype([(name, rows.dtype[name]) for name in old]),
                    repack_fields(rows[old]), 1, len(rows))
    now, then = (json.loads(planes_to_json(one))['planes'] for one in (make('planes'), msg))
    assert len(then) == len(now) == 2
    for plane, before in zip(now, then, strict=True):
        assert before == {name: plane[name] for name in before}
        assert set(plane) - set(before) == {'sigma_normal', 'sigma_d'}


def test_fields_of_planes_of_a_map_stay_where_they_were():
    names = MAP_PLANE_DTYPE.names
    assert names[:len(FIRST) + 6] == (*FIRST, 'first_seen', 'last_seen', 'views', 'subsumed_by',
                                      'sigma_normal', 'sigma_d')
    assert set(PLANE_DTYPE.names) < set(names)
