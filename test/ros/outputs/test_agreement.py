# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
All messages of one image agree with the scene and with one another, in the frame of the world.

From messages to messages: a rendered room, a camera that is rolled and off centre, TF. In the
world, z is the height over the floor, so that most numbers are known without the camera.
"""

import json

import numpy as np
import pytest
from map_helpers import map_plane
from ros_helpers import (
    FRAME_ID,
    camera_info_msg,
    cloud_array,
    header,
    image_array,
    image_msg,
    transform_msg,
)
from scipy.spatial.transform import Rotation

from plane_detector import CameraIntrinsics, Config, PlaneDetector
from plane_detector.config import DepthConfig, MapConfig, NodeConfig
from plane_detector.evaluation.scenes.rendering import camera_rotation, render
from plane_detector.evaluation.scenes.rooms import box
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.mapping.map_plane import as_planes
from plane_detector.mapping.plane_map import MapSnapshot
from plane_detector.ros.frame_processor import FrameProcessor
from plane_detector.ros.inputs.synchronizer import Frame
from plane_detector.ros.inputs.transforms import FrameTransforms, TransformBuffer
from plane_detector.ros.live_map import LiveMap
from plane_detector.ros.outputs.frame import MapView
from plane_detector.ros.outputs.map_messages import map_planes_to_msg
from plane_detector.types import PlaneClass

CAMERA = CameraIntrinsics(290.0, 330.0, 170.0, 105.0, 320, 240)
SIZE_M = np.array([4.0, 5.0, 2.6])
CRATE = np.array([1.9, 3.6, 0.2]), np.array([0.5, 0.6, 0.4])
ROTATION, POSITION_M = camera_rotation(12, -26, 9), np.array([2.1, 1.6, 1.2])
STAMP_S = 7.25


def xyz(table, prefix=''):
    return np.stack([table[f'{prefix}{axis}'] for axis in 'xyz'], axis=-1).astype(float)


def view(things):
    return render(box(SIZE_M / 2, SIZE_M) + things, ROTATION, POSITION_M, CAMERA,
                  np.random.default_rng(0))


def new_processor(live_map=None, **settings):
    """Return a processor of images; the camera stands in the world at all times."""
    buffer = TransformBuffer()
    for stamp_s in (0.0, 100.0):
        buffer.add(transform_msg('world', FRAME_ID, POSITION_M.tolist(),
                                 Rotation.from_matrix(ROTATION).as_quat().tolist(), stamp_s))
    return FrameProcessor(
        PlaneDetector(Config(depth=DepthConfig(source='topic'))),
        NodeConfig(target_frame='world', base_frame='world', **settings), 'image_rect',
        FrameTransforms(buffer), live_map)


def frame_of(scene, stamp_s=STAMP_S, epoch=0):
    return Frame(image_msg(scene.rgb, 'rgb8', stamp_s), camera_info_msg(CAMERA, stamp_s),
                 image_msg((1000 * scene.depth_m).round().astype('u2'), '16UC1', stamp_s),
                 None, epoch)


def outputs(**settings):
    """Return the scene and all messages of its image, placed in the world."""
    scene = view(box(*CRATE))
    return scene, *new_processor(**settings).process(frame_of(scene))


@pytest.fixture(scope='module', params=[{}, {'max_side': 200}], ids=['whole', 'reduced'])
def made(request):
    return outputs(**request.param)


def test_every_message_has_the_stamp_of_the_image_and_its_frame(made):
    _, frame, messages = made
    assert frame.stamp_s == pytest.approx(STAMP_S)
    in_camera = {'labels', 'depth', 'overlay', 'overlay/compressed', 'camera_info'}
    for name, msg in messages.items():
        if name == 'planes_json':
            continue
        for part in msg.markers if name == 'markers' else (
                msg.detections if name == 'detections' else [msg]):
            assert part.header.stamp == header(STAMP_S).stamp, name
            assert part.header.frame_id == (FRAME_ID if name in in_camera else 'world'), name


def test_the_first_image_after_a_jump_back_gives_the_messages_of_a_new_node():
    """Byte for byte, labels too; the map stays and is published at once."""
    rooms, messages, maps = [view(box(*CRATE)), view([])], [], []
    for seen in ([(0, 50.0, 0), (1, 50.1, 0), (0, 50.2, 0), (1, 9.0, 1)], [(1, 9.0, 0)]):
        processor = new_processor(LiveMap(MapConfig(), 'world'))
        for room, stamp_s, epoch in seen:
            _, last = processor.process(frame_of(rooms[room], stamp_s, epoch))
        messages.append({name: msg for name, msg in last.items() if not name.startswith('map/')})
        maps.append(cloud_array(last['map/planes'])[0]['label'])
    assert messages[0].keys() == messages[1].keys()
    for name, msg in messages[0].items():
        assert msg == messages[1][name], name
    assert set(maps[0]) >= set(maps[1]) != set()


def test_points_are_where_the_room_is_and_have_the_label_of_their_plane(made):
    _, frame, messages = made
    cloud, (planes,) = cloud_array(messages['points']), cloud_array(messages['planes'])
    points_m, labels = xyz(cloud), image_array(messages['labels'], 'u2')[..., 0]
    assert messages['points'].header.frame_id == 'world'
    assert messages['labels'].header.frame_id == FRAME_ID
    assert (cloud['label'] == labels).all()
    inside = np.isfinite(points_m).all(axis=-1)
    assert inside.mean() > 0.95
    # Of a room: every point is on a wall, on the floor, on the ceiling or on the crate.
    to_walls = np.minimum(abs(points_m), abs(points_m - SIZE_M)).min(axis=-1)
    to_crate = np.abs(abs(points_m - CRATE[0]) - CRATE[1] / 2).min(axis=-1)
    assert np.quantile(np.minimum(to_walls, to_crate)[inside], 0.97) < 0.02
    for row in planes:
        off_m = points_m[labels == row['label']] @ xyz(row, 'normal_') + row['d']
        assert np.sqrt(np.nanmean(off_m**2)) == pytest.approx(row['rms'], abs=2e-3)
        assert (labels == row['label']).sum() == pytest.approx(row['num_inliers'], rel=0.02)
        assert xyz(row) @ xyz(row, 'normal_') + row['d'] == pytest.approx(0, abs=1e-4)
        mean_m = np.nanmean(points_m[labels == row['label']], axis=0)
        assert xyz(row) == pytest.approx(mean_m, abs=0.02)
        # Seen from the camera, on the front.
        assert POSITION_M @ xyz(row, 'normal_') + row['d'] > 0


def test_the_planes_are_those_of_the_room_with_their_classes(made):
    _, _, messages = made
    (planes,) = cloud_array(messages['planes'])
    known = {(0, 0, 1, 0.0): PlaneClass.FLOOR, (-1, 0, 0, 4.0): PlaneClass.WALL,
             (1, 0, 0, 0.0): PlaneClass.WALL, (0, -1, 0, 5.0): PlaneClass.WALL,
             (0, 0, 1, -0.4): None}
    found = 0
    for row in planes[planes['area'] > 0.15]:
        fits = [kind for (*normal, d), kind in known.items()
                if xyz(row, 'normal_') @ normal > 0.999 and abs(row['d'] - d) < 0.02]
        if fits:
            found += 1
            assert fits[0] in (None, row['class'])
    assert found >= 3


def test_poses_rectangles_outlines_and_json_are_those_of_the_planes(made):
    _, _, messages = made
    (planes,) = cloud_array(messages['planes'])
    (corners,) = cloud_array(messages['boundaries'])
    texts = json.loads(messages['planes_json'].data)
    assert len(messages['plane_poses'].poses) == len(planes) == len(texts['planes'])
    for row, pose in zip(planes, messages['plane_poses'].poses, strict=True):
        normal = xyz(row, 'normal_')
        q = pose.orientation
        axes = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
        assert axes[:, 2] == pytest.approx(normal, abs=1e-4)
        p = pose.position
        assert [p.x, p.y, p.z] == pytest.approx(xyz(row), abs=1e-4)
        own = corners[corners['label'] == row['label']]
        assert abs(xyz(own) @ normal + row['d']).max() < 0.02
        # The rectangle holds the outline, as narrowly as its sides say.
        box_axes = Rotation.from_quat([row[f'rect_q{axis}'] for axis in 'xyzw']).as_matrix()
        assert box_axes[:, 2] == pytest.approx(normal, abs=1e-3)
        flat = (xyz(own[own['hole'] == 0]) - xyz(row, 'rect_')) @ box_axes[:, :2]
        sides = np.array([row['rect_width'], row['rect_height']])
        assert (np.abs(flat).max(axis=0) < sides / 2 + 0.05).all()
        if row['area'] > 0.15:  # else the outline may lack a part of a few pixels
            assert np.ptp(flat, axis=0) == pytest.approx(sides, rel=0.05, abs=0.06)
        assert 0 < row['area'] < 1.1 * sides.prod()


def test_heights_of_ground_and_obstacles_are_those_of_the_world(made):
    _, frame, messages = made
    (ground,) = cloud_array(messages['ground'])
    (obstacles,) = cloud_array(messages['points_without_floor'])
    assert len(ground) > 500 and len(obstacles) > 500
    assert np.quantile(abs(ground['z']), 0.99) < 0.02
    low = obstacles['z'] < 1.0
    assert obstacles['height'][low] == pytest.approx(obstacles['z'][low], abs=0.03)
    is_crate = (np.abs(xyz(obstacles)[:, :2] - CRATE[0][:2]) < CRATE[1][:2] / 2 - 0.05).all(axis=1)
    top = obstacles['z'][is_crate & (obstacles['z'] > 0.38)]
    assert len(top) > 100 and np.median(top) == pytest.approx(0.4, abs=0.01)
    assert frame.detection.camera_height_m == pytest.approx(1.2, abs=0.01)


def test_camera_info_projects_the_points_to_their_pixels(made):
    _, _, messages = made
    points_m = xyz(cloud_array(messages['points']))
    info = messages['camera_info']
    assert (info.height, info.width) == points_m.shape[:2]
    depth_m = image_array(messages['depth'], '<f4')[..., 0]
    k, to_camera = np.reshape(info.k, (3, 3)), (points_m - POSITION_M) @ ROTATION
    valid = np.isfinite(depth_m)
    np.testing.assert_allclose(to_camera[..., 2][valid], depth_m[valid], atol=1e-4)
    pixels = (to_camera / to_camera[..., 2:]) @ k.T
    v, u = np.indices(depth_m.shape)
    np.testing.assert_allclose(pixels[..., 0][valid], u[valid], atol=0.02)
    np.testing.assert_allclose(pixels[..., 1][valid], v[valid], atol=0.02)


def test_the_errors_stated_in_a_map_are_those_of_its_planes_in_the_frame_of_the_poses():
    """Heights are drawn by their covariance; the plane of each draw is computed by its points."""
    axes = Rotation.from_euler('xyz', [20, 30, 40], degrees=True).as_matrix()
    wall = map_plane(4, PlaneClass.WALL, [1.0, 2.0, 3.0], axes, np.ones((4, 8)))
    half = np.array([[3e-3, 0, 0], [1e-3, 8e-3, 0], [-2e-3, 1e-3, 5e-3]])
    wall.covariance[:] = half @ half.T
    transform = RigidTransform(camera_rotation(50, 20, -30), np.array([2.0, -1.0, 0.5]))
    view = MapView(header(1.0), MapSnapshot(
        (wall,), as_planes([wall]).moved(transform), transform), {})
    ((row,),) = cloud_array(map_planes_to_msg(view))
    rng, drawn = np.random.default_rng(0), []
    flat = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    for heights in rng.multivariate_normal(np.zeros(3), wall.covariance, 4000):
        local = np.column_stack([flat, flat @ heights[:2] + heights[2]])
        corners = transform.points(wall.origin_m + local @ axes)
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        normal /= np.linalg.norm(normal)
        drawn.append([*normal, -normal @ corners[0]])
    spread = np.std(drawn, axis=0)
    assert row['sigma_d'] == pytest.approx(spread[3], rel=0.05)
    assert row['sigma_normal'] == pytest.approx(np.linalg.norm(spread[:3]), rel=0.05)
