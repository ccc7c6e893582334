# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What the node knows about missing inputs and results, in its log, once, and its diagnostics."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from node_helpers import change_state, send, start
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_helpers import FRAME_ID, camera_info_msg, header, image_msg, transform_msg
from sensor_msgs.msg import CameraInfo, Imu
from std_srvs.srv import Trigger

from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.ros.frame_worker import MOST_CALLS, FrameRequests
from plane_detector.ros.inputs.topic_watch import ArrivalCount, explain_silence
from plane_detector.ros.inputs.transforms import FrameTransforms, TransformBuffer


@pytest.fixture
def robot(robot, monkeypatch):
    """Return it with a node that waits less before it reports something missing."""
    for module in ('topic_watch', 'subscriptions'):
        monkeypatch.setattr(f'plane_detector.ros.inputs.{module}.GRACE_S', 0.5)
    return robot


def test_depth_with_other_stamps_is_reported_with_the_difference_and_mended_live(robot, room):
    node = start(robot, depth__source='topic')
    stamps_s = iter(np.arange(1.0, 100.0, 0.2))

    def send_both(off_s):
        stamp_s = next(stamps_s)
        robot.publish('camera_info', camera_info_msg(room.intrinsics, stamp_s))
        robot.publish('image', image_msg(room.rgb, 'rgb8', stamp_s))
        robot.publish('depth', image_msg(room.depth_m, '32FC1', stamp_s + off_s))
        robot.settle()

    def is_logged(text):
        return robot.spin(lambda: send_both(off_s) or text in robot.log())
    off_s = 0.06
    assert is_logged('the nearest is 60 ms later; synchronise the camera, or: ros2 param set '
                '/plane_detector stamp_slop 0.08')
    for _ in range(10):
        send_both(off_s)
    assert robot.log().count('synchronise the camera') == 1
    off_s = -0.08
    assert is_logged('the nearest is 80 ms earlier'), 'again when it changes'
    assert not robot.received['planes']
    node.set_parameters([Parameter('stamp_slop', value=0.1)])
    assert robot.spin(lambda: send_both(off_s) or robot.received['planes'])


STAMPS_S = iter(np.arange(1.0, 100_000.0, 0.2))


def depth_arrives(robot, room, off_s, expected, with_info=True):
    """Send images whose depth is so much later until the log says something; return the log."""
    def is_logged():
        stamp_s = next(STAMPS_S)
        if with_info:
            robot.publish('camera_info', camera_info_msg(room.intrinsics, stamp_s))
        robot.publish('image', image_msg(room.rgb, 'rgb8', stamp_s))
        robot.publish('depth', image_msg(room.depth_m, '32FC1', stamp_s + off_s))
        robot.settle()
        return expected in robot.log()
    assert robot.spin(is_logged), robot.log()
    return robot.log()


@pytest.mark.parametrize(('off_s', 'nearest'), [(0.095, '95 ms later'), (-1000.0, 'ms earlier')])
def test_a_slop_of_over_half_a_period_is_not_advised(robot, room, off_s, nearest):
    """Depth of another clock is from long before the images: these wait and are dropped."""
    start(robot, depth__source='topic')
    log = depth_arrives(robot, room, off_s, f'{nearest}; synchronise the camera: a larger '
                        'stamp_slop would pair images with the depth of others')
    assert 'ros2 param set' not in log


def test_without_camera_info_nothing_is_said_of_stamps(robot, room):
    start(robot, depth__source='topic')
    depth_arrives(robot, room, 0.06, 'nobody publishes /camera_info', with_info=False)

    def are_dropped():
        depth_arrives(robot, room, 0.06, 'nobody publishes /camera_info', with_info=False)
        return int(robot.diagnosis()[1]['frames_dropped'])
    assert robot.spin(are_dropped)
    assert 'stamp_slop' not in robot.log()


def test_a_short_start_without_pairs_is_not_reported(robot, room, monkeypatch):
    """Here everything is a short start."""
    monkeypatch.setattr('plane_detector.ros.inputs.subscriptions.GRACE_S', 1000.0)
    start(robot, depth__source='topic')
    for index in range(20):
        send(robot, room, 1.0 + 0.2 * index)
        robot.publish('depth', image_msg(room.depth_m, '32FC1', 1.03 + 0.2 * index))
        robot.settle()
    assert robot.spin(lambda: int(robot.diagnosis()[1]['frames_dropped']) > 2)
    assert 'stamp_slop' not in robot.log()


def test_lost_images_are_counted_and_reported_with_the_remedy(robot, room):
    start(robot, lambda rgb: room.depth_m)
    for index in range(60):
        robot.publish('camera_info', camera_info_msg(room.intrinsics, index / 15))
        if index % 5 not in (1, 3):
            robot.publish('image', image_msg(room.rgb, 'rgb8', index / 15))
        robot.settle()
    assert robot.is_logged('% of the images on /image are missing: /camera_info has more')
    assert 'config/fastdds_large_messages.xml' in robot.log()
    images, _, infos, *_ = robot.diagnosis()[1]['images_received'].replace(',', '').split()
    assert int(images) <= 0.8 * int(infos)


def counted(images_s, infos_s):
    count = ArrivalCount()
    for stamp_s in images_s:
        count.add(round(1e9 * stamp_s), is_image=True)
    for stamp_s in infos_s:
        count.add(round(1e9 * stamp_s), is_image=False)
    return count


def test_images_are_compared_with_the_camera_infos_of_their_time():
    sent_s = np.arange(300) / 30
    found = counted(sent_s[::2], sent_s).arrivals()
    assert found.images == pytest.approx(75, abs=1)
    assert found.camera_infos == pytest.approx(150, abs=2)
    assert found.are_few
    assert not counted(sent_s[100:], sent_s).arrivals().are_few, 'the first images come late'
    assert not counted(sent_s, sent_s[:1]).arrivals().are_few, 'a calibration that is sent once'
    assert not counted(sent_s[:9:2], sent_s[:9]).arrivals().are_few, 'too few to tell'
    assert counted(sent_s[::3], []).period_s == pytest.approx(0.1)


def test_a_bag_in_a_loop_loses_no_images():
    looped_s = np.tile(np.arange(100) / 30, 3)
    count = ArrivalCount()
    for stamp_s in looped_s:
        count.add(round(1e9 * stamp_s), is_image=False)
        count.add(round(1e9 * stamp_s), is_image=True)
        found = count.arrivals()
        assert not found.are_few
        assert found.images <= 100, 'nothing from before a jump of time is counted'


IMAGE, RAW = 'sensor_msgs/msg/CompressedImage', 'sensor_msgs/msg/Image'


@pytest.mark.parametrize('role, published, expected', [
    ('image', {'/camera/depth/image_raw': RAW, '/camera/color/image_raw': RAW},
     'there are /camera/color/image_raw: remap with --ros-args -r image:=/camera/color/image_raw'),
    ('depth', {'/camera/depth/image_raw': RAW, '/camera/color/image_raw': RAW},
     'there are /camera/depth/image_raw: remap'),
    ('depth', {'/camera/color/image_raw': RAW}, 'there is no other topic of type'),
    ('image', {'/camera/depth/image_raw': RAW, '/color/compressed': IMAGE},
     '/color/compressed is a sensor_msgs/msg/CompressedImage: set image_transport to compressed'),
    ('depth', {'/depth/compressedDepth': IMAGE},
     '/depth/compressedDepth is a sensor_msgs/msg/CompressedImage: set depth.transport to '
     'compressedDepth'),
    ('image', {'/a/infrared': RAW, '/z/image_raw': RAW}, 'there are /z/image_raw, /a/infrared'),
])
def test_the_topic_that_is_proposed_is_of_the_kind_and_the_nearest(role, published, expected):
    assert expected in explain_silence(role, '/z/image', RAW, (), published)


def test_a_topic_that_is_in_use_is_not_proposed_for_depth(robot, room):
    start(robot, depth__source='topic')
    robot.publish('image', image_msg(room.rgb, 'rgb8', 1.0))
    assert robot.is_logged('nobody publishes /depth, and there is no other topic')
    assert '-r depth:=/image' not in robot.log()


def test_other_frame_ids_are_reported_once(robot, room):
    start(robot, depth__source='topic')
    for index in range(3):
        info = camera_info_msg(room.intrinsics, 1.0 + index)
        depth = image_msg(room.depth_m, '32FC1', 1.0 + index)
        depth.header.frame_id = 'depth\x1b_frame'
        robot.publish('camera_info', info)
        robot.publish('depth', depth)
        robot.publish('image', image_msg(room.rgb, 'rgb8', 1.0 + index))
        robot.wait_for('planes', index + 1)
    assert robot.log().count('the frame_ids differ') == 1
    assert '"depth\\x1b_frame" of /depth' in robot.log()


def test_two_clocks_on_a_topic_are_named_and_seldom_logged(robot, room, monkeypatch):
    monkeypatch.setattr('plane_detector.ros.inputs.subscriptions._JUMPS_WITHIN_S', 1000.0)
    start(robot, lambda rgb: room.depth_m)
    for index in range(15):
        for start_s in (1.0, 100.0):
            send(robot, room, start_s + 0.01 * index)
            robot.settle()
    assert robot.is_logged('time keeps jumping back on /image: two publishers with different '
                           'clocks? It is published by /robot')
    assert robot.log().count('jump') <= 3


def test_a_parameter_file_for_another_node_is_reported(robot, tmp_path, monkeypatch):
    other, own = tmp_path / 'other.yaml', tmp_path / 'own.yaml'
    other.write_text('front/planes: {ros__parameters: {max_side: 640}}\n'
                     'robot: {camera: {ros__parameters: {max_side: 640}}}\n')
    own.write_text('/**: {ros__parameters: {max_side: 640}}\n')
    monkeypatch.setattr(sys, 'argv', ['node', '--ros-args', '--params-file', str(other),
                                      '--params-file', str(own)])
    start(robot, lambda rgb: None)
    assert robot.log().count('has no section') == 1
    assert (f'{other} has no section for /plane_detector; it has: /front/planes, /robot/camera'
            in robot.log())


def test_a_call_is_answered_as_soon_as_the_camera_is_known_to_have_stopped(robot, room):
    start(robot, lambda rgb: room.depth_m, mode='on_demand')
    for index in range(5):
        send(robot, room, 1.0 + 0.1 * index)
        robot.settle()
    answer = robot.call(Trigger, 'plane_detector/detect')
    assert not answer.success
    assert '/image has stopped' in answer.message, 'not only that the time is over'


def test_two_nodes_of_one_name_are_reported_once(robot):
    start(robot, lambda rgb: None)
    assert 'another node is called' not in robot.log()
    robot.add(Node('plane_detector', context=robot.context))
    assert robot.is_logged('another node is called /plane_detector too')
    robot.spin(timeout_s=0.7)
    assert robot.log().count('another node is called') == 1


class Tf2Buffer(TransformBuffer):
    """Drops what is older by ten seconds than the newest transform, as tf2 does, until cleared."""

    def __init__(self):
        super().__init__()
        self.clear()

    def clear(self):
        self._newest_s = 0
        self._edges.clear()

    def add(self, msg, is_static=False):
        if msg.header.stamp.sec >= self._newest_s - 10:
            self._newest_s = msg.header.stamp.sec
            super().add(msg, is_static)


@pytest.fixture
def tf2(monkeypatch):
    """Stand in for tf2_ros, which cannot be installed here; hold its listeners."""
    tf2 = SimpleNamespace(listening=[], Buffer=Tf2Buffer)

    class TransformListener:
        def __init__(self, buffer, node):
            self.buffer = buffer
            tf2.listening.append(self)

        def unregister(self):
            tf2.listening.remove(self)
    tf2.TransformListener = TransformListener
    monkeypatch.setitem(sys.modules, 'tf2_ros', tf2)
    return tf2


def test_tf_is_listened_to_only_while_the_settings_need_it(robot, tf2):
    node = start(robot, lambda rgb: None, base_frame='base_footprint')
    assert len(tf2.listening) == 1
    assert change_state(robot, Transition.TRANSITION_DEACTIVATE)
    assert change_state(robot, Transition.TRANSITION_CLEANUP)
    assert not tf2.listening
    assert node.set_parameters([Parameter('base_frame', value='')])[0].successful
    assert change_state(robot, Transition.TRANSITION_CONFIGURE)
    assert not tf2.listening


def test_transforms_of_a_bag_in_a_loop_are_used_in_each_turn(robot, room, tf2):
    """Also without simulated time: the stamps of the images jump back."""
    start(robot, lambda rgb: room.depth_m, target_frame='odom')
    (listener,) = tf2.listening

    def is_placed(stamp_s):
        listener.buffer.add(transform_msg('odom', FRAME_ID, stamp_s=stamp_s))
        send(robot, room, stamp_s)
        robot.settle()
        return any(msg.header == placed for msg in robot.received['planes'])
    for stamp_s in (20.0, 40.0, 2.0, 3.0):
        placed = header(stamp_s)
        placed.frame_id = 'odom'
        assert robot.spin(lambda stamp_s=stamp_s: is_placed(stamp_s)), stamp_s


def imu_msg(gravity_imu, stamp_s, frame_id):
    msg = Imu(header=header(stamp_s))
    msg.header.frame_id = frame_id
    force = msg.linear_acceleration
    force.x, force.y, force.z = (-9.81 * gravity_imu).tolist()
    return msg


def with_imu(robot, room, gravity_imu, frame_id='imu_link'):
    """Send images with readings until gravity comes from them."""
    stamps_s = iter(np.arange(1.0, 1000.0, 0.1))

    def is_known():
        stamp_s = next(stamps_s)
        robot.publish('imu', imu_msg(gravity_imu, stamp_s, frame_id))
        send(robot, room, stamp_s)
        return robot.diagnosis()[1].get('gravity') == 'imu'
    assert robot.spin(is_known), robot.log()


def test_the_mounting_of_an_imu_comes_from_tf(robot, room):
    turn = RigidTransform.from_quaternion((0.5, -0.5, 0.5, 0.5), (0.1, 0.0, 0.0))
    buffer = TransformBuffer()
    buffer.add(transform_msg(FRAME_ID, 'imu_link', (0.1, 0.0, 0.0), (0.5, -0.5, 0.5, 0.5)),
               is_static=True)
    start(robot, lambda rgb: room.depth_m, transforms=FrameTransforms(buffer), use_imu=True)
    with_imu(robot, room, turn.rotation.T @ room.gravity_camera)
    assert 'mounting of the IMU: by TF, from imu_link' in robot.log()
    height_m = float(robot.diagnosis()[1]['camera_height_m'])
    assert height_m == pytest.approx(room.height_m, abs=0.1), 'the floor is below'


def test_tf_is_listened_to_until_the_mounting_is_known(robot, room, tf2):
    start(robot, lambda rgb: room.depth_m, use_imu=True)
    (listener,) = tf2.listening
    listener.buffer.add(transform_msg(FRAME_ID, 'imu_link'), is_static=True)
    with_imu(robot, room, room.gravity_camera)
    assert not tf2.listening


@pytest.mark.parametrize(('frame_id', 'count'), [('imu_link', 1), (FRAME_ID, 0)])
def test_an_imu_whose_mounting_is_not_known_is_reported_once(robot, room, frame_id, count):
    start(robot, lambda rgb: room.depth_m, use_imu=True)
    with_imu(robot, room, room.gravity_camera, frame_id)
    assert robot.log().count('the IMU is in imu_link, the image in camera_optical_frame') == count


def test_a_calibration_that_is_published_once_arrives(robot, room):
    once = robot.node.create_publisher(CameraInfo, 'camera_info', QoSProfile(
        depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    once.publish(camera_info_msg(room.intrinsics))
    start(robot, lambda rgb: room.depth_m)
    assert robot.spin(lambda: robot.publish('image', image_msg(room.rgb, 'rgb8', 1.0))
                      or robot.received['planes'])


def test_a_wrong_qos_override_leaves_no_publisher(robot):
    name = 'qos_overrides./plane_detector/labels.publisher.reliability'
    start(robot, lambda rgb: None, wait=False, **{name: 'sometimes'})
    assert robot.is_logged('cannot be configured')
    assert robot.spin(lambda: not robot.node.count_publishers('/plane_detector/planes'))


def test_of_many_calls_most_are_answered_at_once():
    requests = FrameRequests(lambda: None)
    futures = [requests.add() for _ in range(MOST_CALLS + 3)]
    assert [future.done() for future in futures] == [False] * MOST_CALLS + [True] * 3
    assert futures[-1].result() == (False, '16 calls are already waiting for a frame')
    requests.refuse_all('over')
    assert {future.result() for future in futures[:MOST_CALLS]} == {(False, 'over')}
    assert not requests.add().done()


def test_a_frame_from_before_a_call_does_not_answer_it():
    requests = FrameRequests(lambda: None)
    number = requests.accept()
    call = requests.add()
    requests.finish(number, True, 'before')
    assert not call.done()
    requests.finish(requests.accept(), True, 'after')
    assert call.result() == (True, 'after')


def test_a_silent_imu_is_reported(robot, room):
    start(robot, lambda rgb: room.depth_m, use_imu=True)
    for stamp_s in np.arange(1.0, 6.0, 0.25):
        send(robot, room, stamp_s)
        robot.settle()
    assert robot.is_logged('nobody publishes /imu')
    status, _ = robot.diagnosis()
    assert status.level == DiagnosticStatus.WARN
    assert '/imu' in status.message
