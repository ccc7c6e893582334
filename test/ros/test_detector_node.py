# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The node in process: messages in through an executor, messages out against the truth."""

import weakref
from dataclasses import replace

import numpy as np
from lifecycle_msgs.msg import Transition
from node_helpers import assert_true_to, change_state, send, small_room, start
from onnx_models import millimetres_as_rgb, network_parameters, write_depth_network
from ros_helpers import (
    FRAME_ID,
    Robot,
    cloud_array,
    header,
    image_array,
    transform_msg,
)
from scipy.spatial.transform import Rotation
from visualization_msgs.msg import Marker

from plane_detector.planes.classification import PlaneClass
from plane_detector.ros import diagnostics
from plane_detector.ros.inputs.transforms import FrameTransforms, TransformBuffer

PERIOD_S = diagnostics._PERIOD_S  # before the robot of the tests makes it shorter


def test_all_outputs_are_true_to_the_scene(robot, room):
    start(robot, lambda rgb: room.depth_m)
    send(robot, room, 12.25)
    for name in ('points', 'planes', 'labels', 'depth', 'overlay', 'plane_poses'):
        (msg,) = robot.wait_for(name)
        assert msg.header == header(12.25), name
    labels = image_array(robot.received['labels'][0], '<u2')[..., 0]
    assert_true_to(room, robot.received['planes'][0], labels)
    cloud = cloud_array(robot.received['points'][0])
    assert cloud.shape == (240, 320)
    np.testing.assert_array_equal(cloud['label'], labels)
    np.testing.assert_allclose(cloud['z'], room.depth_m, rtol=1e-6)
    depth_m = image_array(robot.received['depth'][0], '<f4')[..., 0]
    np.testing.assert_array_equal(depth_m, room.depth_m)
    assert len(robot.received['plane_poses'][0].poses) == robot.received['planes'][0].width
    assert image_array(robot.received['overlay'][0], 'u1', 3).shape == room.rgb.shape


def test_from_the_image_through_a_network_to_the_outputs(robot, room, tmp_path):
    """The image holds the depth, and a small ONNX network reads it; cleanup frees it."""
    model = write_depth_network(tmp_path / 'network.onnx', height=240, width=320)
    node = start(robot, **network_parameters(model))
    send(robot, replace(room, rgb=millimetres_as_rgb(room.depth_m)))
    (planes,) = robot.wait_for('planes')
    labels = image_array(robot.wait_for('labels')[0], '<u2')[..., 0]
    assert_true_to(room, planes, labels)
    assert robot.diagnosis()[1]['depth_model'] == str(model)
    estimator = weakref.ref(node._processor.detector.source.model)
    assert change_state(robot, Transition.TRANSITION_DEACTIVATE)
    assert estimator() is not None
    assert change_state(robot, Transition.TRANSITION_CLEANUP)
    assert robot.spin(lambda: estimator() is None), 'as soon as no thread is at work'


def test_outputs_without_subscriber_are_not_computed(room, monkeypatch):
    from plane_detector.ros.outputs import topics as outputs
    made = []
    for name, output in outputs.OUTPUTS.items():
        monkeypatch.setitem(outputs.OUTPUTS, name, output._replace(
            make=lambda result, name=name, make=output.make: (made.append(name), make(result))[1]))
    robot = Robot(outputs=('planes',))
    try:
        start(robot, lambda rgb: room.depth_m)
        send(robot, room)
        robot.wait_for('planes')
        assert made == ['planes']
    finally:
        robot.shutdown()


def test_diagnostics(robot, room, monkeypatch):
    monkeypatch.setattr(diagnostics, '_PERIOD_S', PERIOD_S)
    node = start(robot, lambda rgb: room.depth_m)
    # Of late pictures and of the diagnostics.
    assert [timer.timer_period_ns for timer in node.timers] == [100_000_000, 1_000_000_000]
    send(robot, room)
    robot.wait_for('planes')
    assert robot.spin(lambda: robot.diagnosis()[1]['frames_processed'] == '1')
    values = {value.key: value.value for message in robot.received['diagnostics']
              for value in message.status[0].values}
    assert values['state'] == 'active'
    assert values['scale'] == 'metric'
    for key in ('rate_hz', 'latency.total_ms', 'latency.convert_ms', 'latency.messages_ms',
                'depth_model', 'frames_dropped'):
        assert key in values
    assert 'last_error' not in values, 'there was none'
    tables = [status for message in robot.received['diagnostics'] for status in message.status[1:]]
    count = cloud_array(robot.wait_for('planes')[0]).size
    assert [(table.name, table.message) for table in tables] == [
        ('plane_detector: planes', f'{count} planes')], 'once for one frame'
    assert len(tables[0].values) == 1 + count


def test_with_gravity_the_floor_is_classified_and_removed(robot, room):
    start(robot, lambda rgb: room.depth_m, scale__gravity=room.gravity_camera.tolist())
    send(robot, room, 2.5)
    (obstacles,) = robot.wait_for('points_without_floor')
    table = cloud_array(robot.wait_for('planes')[0])[0]
    (floor,) = table[table['class'] == PlaneClass.FLOOR]
    normal = np.array([floor['normal_x'], floor['normal_y'], floor['normal_z']])
    assert normal @ room.gravity_camera < -0.999
    assert PlaneClass.WALL in table['class']
    assert obstacles.header == header(2.5)
    points = cloud_array(obstacles)[0]
    points_m = np.stack([points[axis] for axis in 'xyz'], axis=-1)
    assert np.isfinite(points_m).all()
    # The pixels on the floor, and those at the foot of walls, below ground.min_height.
    on_ground = np.isfinite(room.depth_m).sum() - len(points)
    assert floor['num_inliers'] <= on_ground < 1.2 * floor['num_inliers']
    assert (points_m @ normal + floor['d']).min() > 0.04
    on_floor = np.abs(points_m @ normal + floor['d']) < 0.02
    assert on_floor.mean() < 0.05
    captions = [marker.text for marker in robot.wait_for('markers')[0].markers if marker.text]
    assert any('floor' in caption for caption in captions)


def test_markers_of_lost_planes_and_earlier_nodes_are_deleted(robot, room):
    depths = [room.depth_m, np.full((240, 320), np.nan, np.float32)]
    start(robot, lambda rgb: depths.pop(0))
    send(robot, room, 1.0)
    (first,) = robot.wait_for('markers')
    shown = {(m.ns, m.id) for m in first.markers if m.action == m.ADD}
    labels = set(cloud_array(robot.wait_for('planes')[0])[0]['label'].tolist())
    assert {(ns, label) for ns in ('outline', 'normal') for label in labels} <= shown
    assert any(ns == 'caption' for ns, _ in shown)
    send(robot, room, 2.0)
    second = robot.wait_for('markers', 2)[1]
    assert [m.action for m in second.markers] == [Marker.DELETEALL]
    for markers in (first.markers, second.markers):
        assert (markers[0].action, markers[0].ns) == (Marker.DELETEALL, '')
        assert all(m.header.frame_id == FRAME_ID for m in markers)


ROOM = small_room()


def standing_transforms(frame='base_footprint', stamp_s=0.0, is_static=True):
    """Return TF of a robot that stands on the floor of the room, with z up."""
    up = -ROOM.gravity_camera
    x_axis = np.cross(up, [1.0, 0.0, 0.0])
    x_axis /= np.linalg.norm(x_axis)
    to_base = np.stack([x_axis, np.cross(up, x_axis), up])
    buffer = TransformBuffer()
    buffer.add(transform_msg(frame, FRAME_ID, (0.4, 0.3, ROOM.height_m),
                             Rotation.from_matrix(to_base).as_quat(), stamp_s), is_static)
    return FrameTransforms(buffer)


def test_the_height_of_the_camera_from_tf_makes_a_relative_network_metric(robot):
    def estimate(rgb):
        return (0.4 / ROOM.depth_m).astype(np.float32)

    start(robot, estimate, transforms=standing_transforms(), base_frame='base_footprint',
          depth__output='relative_disparity')
    send(robot, ROOM)
    table = cloud_array(robot.wait_for('planes')[0])[0]
    (floor,) = table[table['class'] == PlaneClass.FLOOR]
    assert abs(floor['d'] - ROOM.height_m) < 0.02
    assert robot.spin(lambda: robot.diagnosis()[1].get('scale') in (
        'camera_height', 'manhattan'))


def test_outputs_in_the_target_frame(robot):
    start(robot, lambda rgb: ROOM.depth_m, transforms=standing_transforms(),
          base_frame='base_footprint', target_frame='base_footprint')
    send(robot, ROOM, 2.5)
    for name in ('points', 'planes', 'plane_poses', 'points_without_floor'):
        received = robot.wait_for(name)[0].header
        assert (received.frame_id, received.stamp) == ('base_footprint', header(2.5).stamp), name
    for name in ('depth', 'labels', 'overlay'):
        assert robot.wait_for(name)[0].header == header(2.5), name
    table = cloud_array(robot.received['planes'][0])[0]
    (floor,) = table[table['class'] == PlaneClass.FLOOR]
    assert floor['normal_z'] > 0.999
    assert abs(floor['z']) < 0.02
    assert abs(floor['d']) < 0.02
    assert {marker.header.frame_id for marker in robot.wait_for('markers')[0].markers} == {
        'base_footprint'}


def test_a_frame_without_transform_is_logged_and_only_its_images_are_published(robot):
    start(robot, lambda rgb: ROOM.depth_m, transforms=standing_transforms(is_static=False),
          target_frame='map')
    send(robot, ROOM)
    assert robot.is_logged('no transform from camera_optical_frame to map')
    assert robot.is_logged('the frames are not connected'), 'the reason of TF itself'
    assert robot.spin(lambda: robot.diagnosis()[1]['frames_skipped'] == '1')
    assert robot.wait_for('labels')[0].header == header(1.0)
    assert not robot.received['planes'] and not robot.received['points']
