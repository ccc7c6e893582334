# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The map of the node: latched topics, services, clicks, diagnostics, messages on faults."""

from geometry_msgs.msg import PointStamped
from node_helpers import send, small_room, start
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_helpers import FRAME_ID, cloud_array, header, transform_msg
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger

from plane_detector.mapping import plane_map
from plane_detector.ros.inputs.transforms import FrameTransforms, TransformBuffer

ROOM = small_room()
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Odometry:
    """TF of a camera, image by image."""

    def __init__(self):
        self.buffer, self.node = TransformBuffer(), None

    def place(self, stamp_s, x_m=0.4, turn_deg=0.0):
        turn = Rotation.from_euler('zy', [30, turn_deg], degrees=True)
        self.buffer.add(transform_msg('odom', FRAME_ID, (x_m, 0.3, 1.2), turn.as_quat(), stamp_s))


def begin(robot, tmp_path, wait=True, **settings):
    odometry = Odometry()
    odometry.node = start(
        robot, lambda rgb: ROOM.depth_m, wait, transforms=FrameTransforms(odometry.buffer),
          **{'map.enabled': True, 'map.file': str(tmp_path / 'map.json'), 'target_frame': 'odom',
             **settings})
    return odometry


def show(robot, odometry, stamp_s, count, **placed):
    odometry.place(stamp_s, **placed)
    send(robot, ROOM, stamp_s)
    return robot.wait_for('planes', count)


def hear(robot):
    robot.node.create_subscription(PointCloud2, '/plane_detector/map/planes',
                                   robot.received['map'].append, LATCHED)


def trigger(robot, name):
    return robot.call(Trigger, f'/plane_detector/map/{name}')


def test_the_map_is_latched_saved_cleared_and_loaded(robot, tmp_path):
    odometry = begin(robot, tmp_path)
    show(robot, odometry, 1.0, 1)
    show(robot, odometry, 1.6, 2)
    hear(robot)  # later than the messages
    assert robot.spin(lambda: robot.received['map']
                      and robot.received['map'][-1].header.stamp == header(1.6).stamp)
    planes = robot.received['map'][-1]
    assert planes.header.frame_id == 'odom'
    labels = cloud_array(planes)[0]['label'].tolist()
    assert len(labels) >= 3
    assert (cloud_array(planes)[0]['views'] == 2).all()
    saved = trigger(robot, 'save')
    assert saved.success, saved.message
    assert str(tmp_path / 'map.json') in saved.message
    assert trigger(robot, 'clear').success
    assert robot.spin(lambda: robot.received['map'][-1].width == 0)
    assert trigger(robot, 'load').success
    assert robot.spin(lambda: robot.received['map'][-1].width == len(labels))
    assert sorted(cloud_array(robot.received['map'][-1])[0]['label']) == sorted(labels)
    (tmp_path / 'map.json').write_text('{"version": 1, "pla')
    cut = trigger(robot, 'load')
    assert not cut.success
    assert 'is not a whole map' in cut.message
    assert robot.spin(lambda: robot.diagnosis()[1].get('map_planes') == str(len(labels)))


def test_a_map_that_was_made_before_clear_is_not_published_after_it(robot, tmp_path):
    odometry = begin(robot, tmp_path)
    hear(robot)
    show(robot, odometry, 1.0, 1)
    robot.wait_for('map')
    node = odometry.node
    late = node._live_map.view(header(1.0).stamp)
    assert trigger(robot, 'clear').success
    assert robot.spin(lambda: robot.received['map'][-1].width == 0)
    node._map.publish(late)
    robot.spin(timeout_s=0.3)
    assert robot.received['map'][-1].width == 0


def test_a_click_beside_the_image_is_answered_from_the_map(robot, tmp_path):
    odometry = begin(robot, tmp_path)
    hear(robot)
    show(robot, odometry, 1.0, 1)
    show(robot, odometry, 1.1, 2)
    row = cloud_array(robot.wait_for('map')[-1])[0][0]
    # Only then nothing is left to do for the image that shows the point.
    assert robot.spin(lambda: robot.diagnosis()[1]['frames_processed'] == '2')
    click = PointStamped()
    click.header.frame_id = 'odom'
    click.point.x, click.point.y, click.point.z = (float(row[axis]) for axis in 'xyz')
    robot.publish('clicked_point', click)
    robot.settle()
    show(robot, odometry, 1.2, 3, turn_deg=180.0)  # the camera looks the other way
    assert robot.is_logged(f'clicked point: plane {row["label"]} of the map')


def test_without_target_frame_the_node_says_what_is_missing(robot, tmp_path):
    begin(robot, tmp_path, wait=False, target_frame='')
    assert robot.is_logged('map.enabled needs target_frame')


def test_an_image_without_transform_is_not_in_the_map_and_counted(robot, tmp_path):
    begin(robot, tmp_path)
    send(robot, ROOM, 1.0)
    robot.wait_for('labels')
    assert robot.spin(lambda: robot.diagnosis()[1].get('map_images_without_pose') == '1')
    assert robot.diagnosis()[1]['map_planes'] == '0'


def test_a_target_frame_that_is_that_of_the_camera_is_reported(robot, tmp_path):
    begin(robot, tmp_path, target_frame=FRAME_ID)
    send(robot, ROOM, 1.0)
    robot.wait_for('planes')
    assert robot.is_logged('is the frame of the camera')


def test_without_a_map_there_is_nothing_of_it(robot):
    start(robot, lambda rgb: ROOM.depth_m)
    send(robot, ROOM, 1.0)
    robot.wait_for('planes')
    names = [name for name, _ in robot.node.get_topic_names_and_types()]
    assert not [name for name in names if '/map/' in name]
    assert 'map_planes' not in robot.diagnosis()[1]


def test_a_jump_is_logged(robot, tmp_path, monkeypatch):
    # The depth of this model is exact.
    monkeypatch.setattr(plane_map, '_NETWORK_SHARE', 0.0)
    monkeypatch.setattr(plane_map, '_NETWORK_TILT_RAD', 0.0)
    odometry = begin(robot, tmp_path)
    for k, x_m in enumerate((0.4, 0.4, 0.55, 0.55, 0.55)):
        show(robot, odometry, 1.0 + 0.1 * k, k + 1, x_m=x_m)
    assert robot.is_logged('the poses have jumped by 15 cm')


def test_subscribers_whose_qos_does_not_fit_are_named(robot, tmp_path):
    """Both want messages from before they came, which none keeps: the map's override says so."""
    begin(robot, tmp_path, **{
        'qos_overrides./plane_detector/map/planes.publisher.durability': 'volatile'})
    hear(robot)
    robot.node.create_subscription(PointCloud2, '/plane_detector/planes', print, LATCHED)
    for topic in ('planes', 'map/planes'):
        assert robot.is_logged(f'/robot subscribes to /plane_detector/{topic}, but receives '
                               'nothing, because its QoS does not fit (')
