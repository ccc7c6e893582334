# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The node in process: messages in through an executor, messages out against the truth."""

import threading
import weakref
from dataclasses import replace

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from onnx_models import millimetres_as_rgb, write_depth_network
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_helpers import (
    FRAME_ID,
    Robot,
    camera_info_msg,
    cloud_array,
    header,
    image_array,
    image_msg,
)
from sensor_msgs.msg import CompressedImage, Imu
from std_srvs.srv import Trigger

from plane_detector.plane_classes import PlaneClass
from plane_detector.ros import node as node_module
from plane_detector.ros.node import PlaneDetectorNode
from plane_detector.tools.scenes import random_room
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(262.5, 262.5, 159.5, 119.5, 320, 240)


@pytest.fixture(scope='module')
def room():
    return random_room(np.random.default_rng(3), CAMERA)


@pytest.fixture
def robot(capfd):
    robot = Robot(capfd=capfd)
    yield robot
    robot.shutdown()


def start(robot, estimate_depth=None, wait=True, **values):
    """Add a node with these parameters, and spin until it is active."""
    overrides = [Parameter(name.replace('__', '.'), value=value) for name, value in values.items()]
    node = PlaneDetectorNode(estimate_depth, context=robot.context, parameter_overrides=overrides)
    robot.add(node)
    if wait:
        assert robot.spin(lambda: node.state == 'active'), robot.log()
    return node


def send(robot, scene, stamp_s=1.0, depth=False):
    robot.publish('camera_info', camera_info_msg(scene.intrinsics, stamp_s))
    if depth:
        robot.publish('depth', image_msg(scene.depth_m, '32FC1', stamp_s))
    robot.publish('image', image_msg(scene.rgb, 'rgb8', stamp_s))


def assert_true_to(scene, planes, labels):
    """Check planes and labels against a rendered scene."""
    table = cloud_array(planes)[0]
    matched = 0
    for truth, plane in enumerate(scene.planes):
        mask = scene.labels == truth
        if mask.sum() < 0.03 * mask.size:
            continue
        label = np.bincount(labels[mask]).argmax()
        (row,) = table[table['label'] == label]
        normal = np.array([row['normal_x'], row['normal_y'], row['normal_z']], float)
        assert normal @ plane[:3] > np.cos(np.radians(1.0))
        assert abs(row['d'] - plane[3]) < 0.01
        assert (labels[mask] == label).mean() > 0.95
        matched += 1
    assert matched >= 3
    assert (table['d'] >= 0).all()
    assert np.isin(labels, np.append(table['label'], 0)).all()


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
    rows, columns = np.mgrid[:240, :320]
    np.testing.assert_allclose(cloud['x'], (columns - CAMERA.cx) / CAMERA.fx * room.depth_m,
                               rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(cloud['y'], (rows - CAMERA.cy) / CAMERA.fy * room.depth_m,
                               rtol=1e-4, atol=1e-5)
    depth_m = image_array(robot.received['depth'][0], '<f4')[..., 0]
    np.testing.assert_array_equal(depth_m, room.depth_m)
    assert len(robot.received['plane_poses'][0].poses) == robot.received['planes'][0].width
    assert image_array(robot.received['overlay'][0], 'u1', 3).shape == room.rgb.shape


def test_the_whole_way_through_a_network(robot, room, tmp_path):
    """The picture holds the depth, and a small ONNX network reads it; cleanup frees it."""
    model = write_depth_network(tmp_path / 'network.onnx', height=240, width=320)
    node = start(robot, depth__model=str(model), depth__output='metric_depth',
                 depth__mean=[0.0, 0.0, 0.0], depth__std=[1.0, 1.0, 1.0])
    send(robot, replace(room, rgb=millimetres_as_rgb(room.depth_m)))
    (planes,) = robot.wait_for('planes')
    labels = image_array(robot.wait_for('labels')[0], '<u2')[..., 0]
    assert_true_to(room, planes, labels)
    assert robot.diagnosis()[1]['depth_model'] == str(model)
    estimator = weakref.ref(node._processor.detector.estimate_depth)
    assert change_state(robot, Transition.TRANSITION_DEACTIVATE)
    assert estimator() is not None
    assert change_state(robot, Transition.TRANSITION_CLEANUP)
    assert estimator() is None


def test_no_plane_is_an_empty_cloud(robot, room):
    start(robot, lambda rgb: np.full(rgb.shape[:2], np.nan, np.float32))
    send(robot, room)
    (planes,) = robot.wait_for('planes')
    assert (planes.height, planes.width) == (1, 0)


@pytest.mark.parametrize('encoding, scale', [('32FC1', 1.0), ('16UC1', 1000.0)])
def test_depth_from_the_topic(robot, room, encoding, scale):
    start(robot, depth__source='topic')
    dtype = np.float32 if encoding == '32FC1' else np.uint16
    depth = np.nan_to_num(room.depth_m * scale).astype(dtype)
    robot.publish('camera_info', camera_info_msg(CAMERA, 1.0))
    robot.publish('depth', image_msg(depth, encoding, 1.0))
    robot.publish('image', image_msg(room.rgb, 'rgb8', 1.0))
    (planes,) = robot.wait_for('planes')
    labels = image_array(robot.wait_for('labels')[0], '<u2')[..., 0]
    assert_true_to(room, planes, labels)


def test_frames_before_the_first_camera_info_are_dropped_with_a_warning(robot, room):
    start(robot, lambda rgb: room.depth_m)
    for index in range(3):
        robot.publish('image', image_msg(room.rgb, 'rgb8', index))
        robot.spin(timeout_s=0.1)
    assert robot.is_logged('/camera_info')
    assert robot.log().count('/camera_info') == 1, 'the warning is throttled'
    status, _ = robot.diagnosis()
    assert status.level == DiagnosticStatus.WARN
    assert '/camera_info' in status.message
    send(robot, room, 5.0)
    assert robot.wait_for('planes')[0].header == header(5.0)
    assert robot.spin(lambda: robot.diagnosis()[1]['frames_dropped'] == '3')


def bad_frames(room):
    """Yield a name, a message and what the log must say of it."""
    yield 'encoding', image_msg(room.rgb, 'rgb32', 2.0), 'rgb32'
    short = image_msg(room.rgb, 'rgb8', 2.0)
    short.data = short.data[:-10]
    yield 'data', short, 'height x step'
    step = image_msg(room.rgb, 'rgb8', 2.0)
    step.step = 7
    yield 'step', step, 'step is 7'
    empty = image_msg(room.rgb, 'rgb8', 2.0)
    empty.width = empty.height = empty.step = 0
    empty.data = []
    yield 'empty', empty, 'empty'
    yield 'size', image_msg(room.rgb[:100], 'rgb8', 2.0), '320 x 100'


def test_bad_frames_are_logged_and_skipped(robot, room):
    start(robot, lambda rgb: room.depth_m)
    robot.publish('camera_info', camera_info_msg(CAMERA, 2.0))
    frames = list(bad_frames(room))
    for name, msg, reason in frames:
        robot.publish('image', msg)
        assert robot.is_logged(reason), name
    status, values = robot.diagnosis()
    assert values['frames_skipped'] == str(len(frames))
    assert '320 x 100' in values['last_error']
    assert status.level == DiagnosticStatus.WARN
    assert not robot.received['planes']
    send(robot, room, 3.0)
    assert robot.wait_for('planes')[0].header == header(3.0)


def test_a_reason_to_skip_is_logged_once_also_between_others(robot, room, monkeypatch):
    monkeypatch.setattr(node_module, '_WARN_PERIOD_S', 3.0)
    node = start(robot, lambda rgb: room.depth_m)
    robot.publish('camera_info', camera_info_msg(CAMERA, 2.0))

    def skip(*encodings):
        for encoding in encodings:
            count = node._statistics._skipped
            robot.publish('image', image_msg(room.rgb, encoding, 2.0))
            assert robot.spin(lambda count=count: node._statistics._skipped > count)

    skip('rgb32', 'rgb32', 'bgr32', 'rgb32', 'bgr32')
    assert [robot.log().count(f"'{encoding}'") for encoding in ('rgb32', 'bgr32')] == [1, 1]
    robot.spin(timeout_s=3.0)
    skip('rgb32')
    assert robot.spin(lambda: robot.log().count("'rgb32'") == 2), 'what stays is told again'


def test_a_picture_that_overtakes_the_calibration_of_its_size_is_processed(robot, room):
    start(robot, lambda rgb: np.full(rgb.shape[:2], 2.0, np.float32))
    send(robot, room, 1.0)
    robot.wait_for('planes')
    robot.publish('image', image_msg(room.rgb[:120, :160], 'rgb8', 1.1))
    robot.spin(timeout_s=0.3)
    robot.publish('camera_info', camera_info_msg(replace(CAMERA, width=160, height=120), 1.1))
    assert robot.wait_for('planes', 2)[1].header == header(1.1)
    assert robot.diagnosis()[1]['frames_skipped'] == '0'


def test_depth_that_cannot_belong_to_the_picture_is_skipped(robot, room):
    start(robot, depth__source='topic')
    robot.publish('camera_info', camera_info_msg(CAMERA, 1.0))
    robot.publish('depth', image_msg(room.depth_m[:50], '32FC1', 1.0))
    robot.publish('image', image_msg(room.rgb, 'rgb8', 1.0))
    assert robot.is_logged('320 x 50')
    send(robot, room, 2.0, depth=True)
    assert robot.wait_for('planes')[0].header == header(2.0)


def test_an_uncalibrated_camera_is_refused(robot, room):
    start(robot, lambda rgb: room.depth_m)
    info = camera_info_msg(CAMERA, 1.0)
    info.k = [0.0] * 9
    robot.publish('camera_info', info)
    robot.publish('image', image_msg(room.rgb, 'rgb8', 1.0))
    assert robot.is_logged('not calibrated')


def test_a_calibration_that_is_not_finite_is_refused_in_plain_numbers(robot, room):
    start(robot, lambda rgb: room.depth_m)
    info = camera_info_msg(CAMERA, 1.0)
    info.k[0] = float('nan')
    robot.publish('camera_info', info)
    robot.publish('image', image_msg(room.rgb, 'rgb8', 1.0))
    assert robot.is_logged('must be finite, not CameraIntrinsics(fx=nan, fy=262.5, cx=159.5, '
                           'cy=119.5, width=320, height=240)')


def test_an_estimator_that_fails_does_not_end_the_node(robot, room):
    failures = [RuntimeError('out of memory')]

    def estimate(rgb):
        if failures:
            raise failures.pop()
        return room.depth_m

    start(robot, estimate)
    send(robot, room, 1.0)
    assert robot.is_logged('out of memory')
    send(robot, room, 2.0)
    assert robot.wait_for('planes')[0].header == header(2.0)


def test_the_freshest_frame_wins(robot, room):
    busy, free = threading.Event(), threading.Event()

    def estimate(rgb):
        busy.set()
        assert free.wait(20)
        return room.depth_m

    node = start(robot, estimate)
    send(robot, room, 1.0)
    assert robot.spin(busy.is_set)
    for stamp_s in (2.0, 3.0, 4.0):
        send(robot, room, stamp_s)
        robot.spin(timeout_s=0.2)
    free.set()
    planes = robot.wait_for('planes', 2)
    robot.spin(timeout_s=0.3)
    assert [msg.header for msg in planes] == [header(1.0), header(4.0)]
    assert robot.diagnosis()[1]['frames_dropped'] == '2'
    assert node.state == 'active'


def test_outputs_without_subscriber_are_not_computed(room, monkeypatch):
    from plane_detector.ros import outputs
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


def test_diagnostics(robot, room):
    start(robot, lambda rgb: room.depth_m)
    send(robot, room)
    robot.wait_for('planes')
    assert robot.spin(lambda: robot.diagnosis()[1]['frames_processed'] == '1')
    first, second = robot.wait_for('diagnostics', len(robot.received['diagnostics']) + 2)[-2:]
    period_s = (second.header.stamp.sec - first.header.stamp.sec
                + (second.header.stamp.nanosec - first.header.stamp.nanosec) * 1e-9)
    assert 0.5 < period_s < 2.0
    values = {value.key: value.value for message in robot.received['diagnostics']
              for value in message.status[0].values}
    assert values['state'] == 'active'
    assert values['scale'] == 'metric'
    for key in ('rate_hz', 'latency.total_ms', 'latency.convert_ms', 'latency.messages_ms',
                'depth_model', 'frames_dropped', 'last_error'):
        assert key in values


def test_depth_of_unknown_unit_is_called_relative(robot, room):
    def estimate(rgb):
        return 1 / room.depth_m

    estimate.output = 'relative_disparity'
    start(robot, estimate)
    send(robot, room)
    robot.wait_for('planes')
    assert robot.spin(lambda: robot.diagnosis()[1]['scale'] == 'relative')
    captions = [m.text for m in robot.wait_for('markers')[0].markers if m.text]
    assert captions
    assert not any(text.endswith(' m') for text in captions)


def test_with_gravity_the_floor_is_told_and_left_out(robot, room):
    start(robot, lambda rgb: room.depth_m, scale__gravity=room.down_camera.tolist())
    send(robot, room, 2.5)
    (obstacles,) = robot.wait_for('points_without_floor')
    table = cloud_array(robot.wait_for('planes')[0])[0]
    (floor,) = table[table['class'] == PlaneClass.FLOOR]
    normal = np.array([floor['normal_x'], floor['normal_y'], floor['normal_z']])
    assert normal @ room.down_camera < -0.999
    assert PlaneClass.WALL in table['class']
    assert obstacles.header == header(2.5)
    points = cloud_array(obstacles)[0]
    points_m = np.stack([points[axis] for axis in 'xyz'], axis=-1)
    assert np.isfinite(points_m).all()
    assert len(points) == np.isfinite(room.depth_m).sum() - floor['num_inliers']
    on_floor = np.abs(points_m @ normal + floor['d']) < 0.02
    assert on_floor.mean() < 0.05
    captions = [marker.text for marker in robot.wait_for('markers')[0].markers if marker.text]
    assert any('floor' in caption for caption in captions)


def test_gravity_from_the_imu(robot, room):
    start(robot, lambda rgb: room.depth_m, use_imu=True)
    imu = Imu(header=header(1.0))
    force = imu.linear_acceleration
    force.x, force.y, force.z = (-9.81 * room.down_camera).tolist()
    robot.publish('imu', imu)
    robot.spin(timeout_s=0.2)
    send(robot, room, 1.01)
    assert PlaneClass.FLOOR in cloud_array(robot.wait_for('planes')[0])[0]['class']


def test_without_gravity_there_is_no_cloud_of_obstacles(robot, room):
    start(robot, lambda rgb: room.depth_m)
    send(robot, room)
    assert not cloud_array(robot.wait_for('planes')[0])[0]['class'].any()
    robot.spin(timeout_s=0.3)
    assert not robot.received['points_without_floor']


def test_measured_depth_fixes_the_scale_of_a_relative_network(robot, room):
    def estimate(rgb):
        return (0.4 / room.depth_m - 0.03).astype(np.float32)

    estimate.output = 'relative_disparity'
    start(robot, estimate)
    send(robot, room, 1.0, depth=True)
    robot.wait_for('planes')
    send(robot, room, 1.1, depth=True)
    planes = robot.wait_for('planes', 2)[1]
    labels = image_array(robot.wait_for('labels', 2)[1], '<u2')[..., 0]
    assert_true_to(room, planes, labels)
    assert robot.spin(lambda: robot.diagnosis()[1]['scale'] == 'depth_topic')
    assert robot.is_logged('depth_topic')


def test_region_of_interest_and_binning(robot, room):
    """The node sees every second pixel of a part of the picture, and finds the same planes."""
    start(robot, lambda rgb: np.ascontiguousarray(room.depth_m[20:220:2, 40:300:2]))
    info = camera_info_msg(CAMERA, 1.0)
    info.roi.x_offset, info.roi.y_offset, info.roi.width, info.roi.height = 40, 20, 260, 200
    info.binning_x = info.binning_y = 2
    robot.publish('camera_info', info)
    robot.publish('image', image_msg(room.rgb[20:220:2, 40:300:2], 'rgb8', 1.0))
    (planes,) = robot.wait_for('planes')
    labels = image_array(robot.wait_for('labels')[0], '<u2')[..., 0]
    assert_true_to(replace(room, labels=room.labels[20:220:2, 40:300:2]), planes, labels)


def test_a_distorted_camera_is_rectified(robot, room):
    """The picture of a lens is made by distorting the rendered one; the planes come out right."""
    distortion = np.array([-0.25, 0.08, 0.001, 0.001, 0.0])
    matrix = np.array([[CAMERA.fx, 0, CAMERA.cx], [0, CAMERA.fy, CAMERA.cy], [0, 0, 1]])
    columns, rows = np.meshgrid(np.arange(320, dtype=np.float64), np.arange(240))
    straight = cv2.undistortPoints(np.stack([columns, rows], -1).reshape(-1, 1, 2), matrix,
                                   distortion, P=matrix).reshape(240, 320, 2).astype(np.float32)
    seen = cv2.remap(room.rgb, straight[..., 0], straight[..., 1], cv2.INTER_LINEAR)
    pictures = []

    def estimate(rgb):
        pictures.append(rgb)
        return room.depth_m

    start(robot, estimate)
    info = camera_info_msg(CAMERA, 1.0)
    info.d = distortion.tolist()
    robot.publish('camera_info', info)
    robot.publish('image', image_msg(seen, 'rgb8', 1.0))
    robot.wait_for('planes')
    centre = np.s_[40:200, 50:270]
    error = np.abs(cv2.blur(pictures[0], (5, 5)).astype(int) - cv2.blur(room.rgb, (5, 5)))[centre]
    unrectified = np.abs(cv2.blur(seen, (5, 5)).astype(int) - cv2.blur(room.rgb, (5, 5)))[centre]
    assert error.mean() < unrectified.mean() / 4


@pytest.mark.parametrize('extension', ['.png', '.jpg'])
def test_compressed_transport(robot, room, extension):
    pictures = []

    def estimate(rgb):
        pictures.append(rgb)
        return room.depth_m

    start(robot, estimate, image_transport='compressed')
    _, data = cv2.imencode(extension, room.rgb[..., ::-1])
    msg = CompressedImage(header=header(4.0), format=extension[1:], data=data.tobytes())
    robot.publish('camera_info', camera_info_msg(CAMERA, 4.0))
    robot.publish('image/compressed', msg)
    assert robot.wait_for('planes')[0].header == header(4.0)
    assert np.abs(pictures[0].astype(int) - room.rgb).mean() < 4


def test_the_clouds_can_be_thinned(robot, room):
    start(robot, lambda rgb: room.depth_m, points_decimation=4)
    send(robot, room)
    cloud = cloud_array(robot.wait_for('points')[0])
    assert cloud.shape == (60, 80)
    np.testing.assert_allclose(cloud['z'], room.depth_m[::4, ::4], rtol=1e-6)
    assert image_array(robot.wait_for('labels')[0], '<u2').shape[:2] == (240, 320)


def test_markers_of_planes_gone_are_deleted(robot, room):
    depths = [room.depth_m, np.full((240, 320), np.nan, np.float32)]
    start(robot, lambda rgb: depths.pop(0))
    send(robot, room, 1.0)
    (first,) = robot.wait_for('markers')
    shown = {(m.ns, m.id) for m in first.markers if m.action == m.ADD}
    labels = set(cloud_array(robot.wait_for('planes')[0])[0]['label'].tolist())
    assert shown == {(ns, label) for ns in ('outline', 'normal', 'caption') for label in labels}
    send(robot, room, 2.0)
    second = robot.wait_for('markers', 2)[1]
    assert {(m.ns, m.id) for m in second.markers if m.action == m.DELETE} == shown
    assert all(m.header.frame_id == FRAME_ID for m in second.markers)


def test_a_jump_back_in_time_is_survived_and_logged(robot, room):
    start(robot, lambda rgb: room.depth_m)
    send(robot, room, 100.0)
    robot.wait_for('planes')
    send(robot, room, 5.0)
    assert robot.wait_for('planes', 2)[1].header == header(5.0)
    assert robot.is_logged('time jumped back')


def test_on_demand_one_frame_per_call(robot, room):
    start(robot, lambda rgb: room.depth_m, mode='on_demand')
    send(robot, room, 1.0)
    robot.spin(timeout_s=0.5)
    assert not robot.received['planes']
    assert robot.call(Trigger, 'plane_detector/detect').success
    for stamp_s in (2.0, 3.0):
        send(robot, room, stamp_s)
        robot.spin(timeout_s=0.5)
    assert [msg.header for msg in robot.received['planes']] == [header(2.0)]


def labels_of(planes):
    return cloud_array(planes)[0]['label'].tolist()


def test_labels_stay_until_tracking_is_reset(robot, room):
    """The largest plane goes out of view: the others keep their labels, until the reset."""
    largest = np.bincount(room.labels[room.labels >= 0]).argmax()
    without = np.where(room.labels == largest, np.nan, room.depth_m).astype(np.float32)
    depths = [room.depth_m, without, without]
    start(robot, lambda rgb: depths.pop(0))
    send(robot, room, 1.0)
    first = labels_of(robot.wait_for('planes')[0])
    assert first == list(range(1, len(first) + 1))
    send(robot, room, 1.1)
    second = labels_of(robot.wait_for('planes', 2)[1])
    assert 1 not in second
    assert set(second) <= set(first)
    assert robot.call(Trigger, 'plane_detector/reset_tracking').success
    send(robot, room, 1.2)
    third = labels_of(robot.wait_for('planes', 3)[2])
    assert third == list(range(1, len(third) + 1))


def test_parameters_change_between_frames(robot, room):
    node = start(robot, lambda rgb: room.depth_m)
    send(robot, room, 1.0)
    assert robot.wait_for('planes')[0].width > 1
    (result,) = node.set_parameters([Parameter('segmentation.max_planes', value=1)])
    assert result.successful
    send(robot, room, 2.0)
    assert robot.wait_for('planes', 2)[1].width == 1


@pytest.mark.parametrize('name, value, reason', [
    ('segmentation.max_planes', 0, 'out of range'),
    ('segmentation.max_planes', 2.0, 'type'),
    ('mode', 'sometimes', 'must be one of'),
    ('depth.model', 'other.onnx', 'read-only')])
def test_impossible_changes_are_refused_and_change_nothing(robot, name, value, reason):
    node = start(robot, lambda rgb: None)
    before = node.get_parameter(name).value
    (result,) = node.set_parameters([Parameter(name, value=value)])
    assert not result.successful
    assert reason in result.reason
    assert node.get_parameter(name).value == before


def test_configuring_fails_with_the_reason_and_can_be_tried_again(robot, tmp_path):
    node = start(robot, wait=False, depth__model=str(tmp_path / 'missing.onnx'),
                 depth__output='metric_depth')
    status, values = robot.diagnosis()
    assert status.level == DiagnosticStatus.ERROR
    assert 'missing.onnx' in values['last_error']
    assert node.state == 'unconfigured'
    assert not change_state(robot, Transition.TRANSITION_CONFIGURE)


def change_state(robot, transition):
    request = ChangeState.Request(transition=Transition(id=transition))
    return robot.call(ChangeState, 'plane_detector/change_state', request).success


def test_lifecycle_without_autostart(robot, room):
    node = start(robot, lambda rgb: room.depth_m, wait=False, autostart=False)
    robot.spin(timeout_s=0.3)
    assert node.state == 'unconfigured'
    assert not robot.call(Trigger, 'plane_detector/detect').success
    assert not change_state(robot, Transition.TRANSITION_ACTIVATE), 'not from unconfigured'
    for _ in range(2):
        assert change_state(robot, Transition.TRANSITION_CONFIGURE)
        assert node.state == 'inactive'
        assert change_state(robot, Transition.TRANSITION_ACTIVATE)
        count = len(robot.received['planes'])
        send(robot, room)
        robot.wait_for('planes', count + 1)
        assert change_state(robot, Transition.TRANSITION_DEACTIVATE)
        assert node.count_subscribers('image') == 0
        assert change_state(robot, Transition.TRANSITION_CLEANUP)
        assert node.state == 'unconfigured'
        assert node.count_publishers('plane_detector/planes') == 0


def test_reliability_follows_the_publishers(robot, room):
    start(robot, lambda rgb: room.depth_m)
    best_effort = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
    robot.publish('camera_info', camera_info_msg(CAMERA, 1.0))

    def offered():
        infos = robot.node.get_subscriptions_info_by_topic('/image')
        return [info.qos_profile.reliability for info in infos]

    assert robot.spin(lambda: offered() == [ReliabilityPolicy.RELIABLE])
    robot.publish('image', image_msg(room.rgb, 'rgb8', 1.0), best_effort)
    assert robot.spin(lambda: offered() == [ReliabilityPolicy.BEST_EFFORT])
    robot.publish('image', image_msg(room.rgb, 'rgb8', 2.0))
    robot.wait_for('planes')


def test_an_override_of_the_reliability_stands(robot):
    node = start(robot, lambda rgb: None, **{
        'qos_overrides./image.subscription.reliability': 'best_effort',
        'qos_overrides./plane_detector/points.publisher.depth': 7})
    (info,) = node.get_subscriptions_info_by_topic('/image')
    assert info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    for topic in ('planes', 'labels', 'markers', 'overlay', 'depth', 'plane_poses'):
        assert node.has_parameter(f'qos_overrides./plane_detector/{topic}.publisher.reliability')
    assert node.has_parameter('qos_overrides./diagnostics.publisher.depth')
    assert node.get_parameter('qos_overrides./plane_detector/points.publisher.depth').value == 7


def test_a_wrong_override_fails_with_the_reason(robot):
    node = start(robot, lambda rgb: None, wait=False,
                 **{'qos_overrides./image.subscription.reliability': 'perfect'})
    assert robot.is_logged('perfect')
    robot.spin(timeout_s=0.3)
    assert node.state == 'inactive'
    assert robot.diagnosis()[0].level == DiagnosticStatus.ERROR


def test_a_simulation_that_stands_still_does_not_stop_the_node(robot, room):
    start(robot, lambda rgb: room.depth_m, use_sim_time=True)
    send(robot, room, 3.0)
    assert robot.wait_for('planes')[0].header == header(3.0)
    assert robot.diagnosis()[0].level in (DiagnosticStatus.OK, DiagnosticStatus.WARN)
