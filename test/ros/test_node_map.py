# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The map of the node: latched topics, services, clicks, diagnostics, messages on faults."""

import json
import math
import sys
from pathlib import Path

import map_file_faults
import numpy as np
import pytest
from geometry_msgs.msg import PointStamped
from lifecycle_msgs.msg import Transition
from map_file_faults import hostile, set_field
from node_helpers import change_state, send, small_room, start
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_helpers import FRAME_ID, cloud_array, header, transform_msg
from rosgraph_msgs.msg import Clock
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger

from plane_detector.evaluation.scenes.walks import walk, with_errors
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.mapping import plane_map
from plane_detector.ros.inputs.transforms import FrameTransforms, TransformBuffer
from plane_detector.ros.live_map import file_of
from plane_detector.types import CameraIntrinsics

ROOM = small_room()
STATIC = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
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


def last_labels(robot):
    """Return the labels of the last map that was published."""
    return set(cloud_array(robot.received['map'][-1])[0]['label'].tolist())


def test_the_last_image_is_shown_though_none_follows(robot, tmp_path):
    """Two images within the time between two maps; the stamps of both are 0."""
    odometry = begin(robot, tmp_path)
    hear(robot)
    for count in (1, 2, 3):
        show(robot, odometry, 0.0, count)
        robot.spin(timeout_s=0.05)
    assert robot.spin(lambda: robot.received['map'] and (
        cloud_array(robot.received['map'][-1])[0]['views'] == 3).all())


def test_what_is_cleared_or_loaded_while_inactive_is_shown_when_active(robot, tmp_path):
    odometry = begin(robot, tmp_path)
    hear(robot)
    show(robot, odometry, 1.0, 1)
    labels = last_labels(robot) if robot.wait_for('map') else None
    assert trigger(robot, 'save').success
    for act, expected in (('clear', set()), ('load', labels)):
        assert change_state(robot, Transition.TRANSITION_DEACTIVATE)
        robot.settle()
        count = len(robot.received['map'])
        assert trigger(robot, act).success
        robot.spin(timeout_s=0.8)
        assert len(robot.received['map']) == count, 'an inactive node publishes nothing'
        assert change_state(robot, Transition.TRANSITION_ACTIVATE)
        assert robot.spin(lambda n=count: len(robot.received['map']) > n)
        assert last_labels(robot) == expected


def test_what_is_shown_is_the_last_state_when_deactivated(robot, tmp_path):
    odometry = begin(robot, tmp_path)
    hear(robot)
    show(robot, odometry, 1.0, 1)
    robot.wait_for('map')
    show(robot, odometry, 1.1, 2)
    assert robot.spin(lambda: robot.diagnosis()[1]['frames_processed'] == '2')
    assert change_state(robot, Transition.TRANSITION_DEACTIVATE)
    assert robot.spin(lambda: (cloud_array(robot.received['map'][-1])[0]['views'] == 2).all())


def test_saved_is_what_is_shown(robot, tmp_path):
    """Planes that one image alone has shown are in neither."""
    odometry = begin(robot, tmp_path)
    hear(robot)
    show(robot, odometry, 1.0, 1)
    show(robot, odometry, 1.1, 2)
    show(robot, odometry, 1.2, 3, turn_deg=180.0)
    assert robot.spin(lambda: robot.received['map'] and robot.received['map'][-1].header.stamp
                      == header(1.2).stamp)
    assert trigger(robot, 'save').success
    rows = {row['label']: row for row in cloud_array(robot.received['map'][-1])[0]}
    saved = {row['label']: row for row in json.loads(
        (tmp_path / 'map.json').read_text())['planes']}
    assert len(odometry.node._map._map.planes) > len(saved)
    assert saved.keys() == rows.keys()
    for label, row in rows.items():
        assert saved[label]['d'] == pytest.approx(row['d'], abs=1e-5)
        assert saved[label]['views'] == row['views']
        assert saved[label]['covariance'][15] ** 0.5 == pytest.approx(row['sigma_d'], rel=1e-4)


def test_a_full_map_takes_planes_again_after_clear(robot, tmp_path, monkeypatch):
    monkeypatch.setattr(plane_map, 'MOST_PLANES', 2)
    odometry = begin(robot, tmp_path)
    hear(robot)
    show(robot, odometry, 1.0, 1)
    assert robot.is_logged('the map has 2 planes of')
    assert 'takes no more' in robot.diagnosis()[0].message
    monkeypatch.setattr(plane_map, 'MOST_PLANES', 2000)
    assert trigger(robot, 'clear').success
    assert 'takes no more' not in robot.diagnosis()[0].message
    show(robot, odometry, 1.1, 2)
    assert robot.spin(lambda: robot.received['map'][-1].width >= 3)


def test_a_click_of_nan_is_refused(robot, tmp_path):
    odometry = begin(robot, tmp_path)
    hear(robot)
    show(robot, odometry, 1.0, 1)
    robot.wait_for('map')
    click = PointStamped()
    click.header.frame_id = 'odom'
    click.point.x = math.nan
    robot.publish('clicked_point', click)
    robot.settle()
    show(robot, odometry, 1.2, 2)
    assert robot.is_logged('is not finite')
    assert 'clicked point: plane' not in robot.log()


def test_odd_files_are_refused_while_images_go_on(robot, tmp_path):
    """Each with a reason, no image is skipped, and the map stays as it was."""
    odometry, path = begin(robot, tmp_path), tmp_path / 'map.json'
    hear(robot)
    show(robot, odometry, 1.0, 1)
    labels = last_labels(robot) if robot.wait_for('map') else None
    assert trigger(robot, 'save').success
    good = path.read_text()
    odd = {f'{field} {value}': set_field(json.loads(good), field, value).encode()
           for field, value in (
               ('planes.0.label', 2**40), ('planes.0.label', -1), ('planes.0.views', -1),
               ('correction.translation', 2), ('correction.translation.0', math.nan),
               ('planes.0.kept.covariance', [[0] * 3] * 3), ('planes.0.kept.runs', [10**11]),
               ('planes.0.kept.cell', 0),
               ('planes.1.label', json.loads(good)['planes'][0]['label']))}
    for count, (name, data) in enumerate({**odd, **hostile()}.items(), 2):
        path.write_bytes(data)
        answer = trigger(robot, 'load')
        assert not answer.success and len(answer.message) > 10, name
        show(robot, odometry, 1.0 + 0.6 * count, count)
        assert robot.spin(lambda c=count: robot.received['map'][-1].header.stamp
                          == header(1.0 + 0.6 * c).stamp), name
        assert last_labels(robot) == labels
    assert robot.diagnosis()[1]['frames_skipped'] == '0'
    path.write_text(good)
    assert trigger(robot, 'load').success


@pytest.mark.parametrize('count', [16, 100])
@pytest.mark.parametrize('service', ['detect', 'map/save'])
def test_of_many_calls_at_once_all_are_answered(robot, tmp_path, service, count):
    """
    Those of ~/detect above sixteen are refused; an image answers the others.

    A client gets the answers of all others too: here, where one executor takes them one by one,
    more may wait than the ten of the default.
    """
    odometry = begin(robot, tmp_path)
    clients = [robot.node.create_client(Trigger, f'/plane_detector/{service}',
                                        qos_profile=QoSProfile(depth=1000))
               for _ in range(count)]
    assert robot.spin(lambda: all(client.service_is_ready() for client in clients))
    futures = [client.call_async(Trigger.Request()) for client in clients]
    odometry.place(1.0)
    robot.spin(timeout_s=0.5)
    send(robot, ROOM, 1.0)
    assert robot.spin(lambda: all(future.done() for future in futures), 20.0), (
        f'{sum(future.done() for future in futures)} of {count}')
    answered = sum(future.result().success for future in futures)
    assert answered == (16 if service == 'detect' else count)


def test_a_wrong_override_of_a_click_leaves_no_publisher(robot, tmp_path):
    name = 'qos_overrides./clicked_point.subscription.reliability'
    begin(robot, tmp_path, wait=False, **{name: 'perhaps'})
    assert robot.is_logged('cannot be configured')
    for topic in ('clicked_plane', 'map/planes', 'planes'):
        assert robot.node.count_publishers(f'/plane_detector/{topic}') == 0


def test_the_file_is_in_the_home_folder_if_it_says_so(robot, tmp_path, monkeypatch):
    monkeypatch.setenv('HOME', str(tmp_path))
    odometry = begin(robot, tmp_path, **{'map.file': '~/here.json'})
    show(robot, odometry, 1.0, 1)
    assert trigger(robot, 'save').success
    assert (tmp_path / 'here.json').exists()


def test_each_node_has_a_file_of_its_own(robot, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    odometry = begin(robot, tmp_path, **{'map.file': 'auto'})
    show(robot, odometry, 1.0, 1)
    answer = trigger(robot, 'save')
    assert str(tmp_path / 'plane_detector_map.json') in answer.message
    other = NamedNode('/front/plane_detector')
    assert file_of('auto', other) == Path('front_plane_detector_map.json')


def test_an_empty_file_name_is_refused_with_what_to_do(robot, tmp_path):
    begin(robot, tmp_path, wait=False, **{'map.file': ''})
    assert robot.is_logged('map.file is empty: set it to the file of the map, or to auto')


class NamedNode:
    """What a file name needs of a node."""

    def __init__(self, name):
        self.get_fully_qualified_name = lambda: name


WALK_CAMERA = CameraIntrinsics(262.5, 262.5, 159.5, 119.5, 320, 240)
IMAGES, STEP_S = 8, 0.2
# From the camera to the base, 20 cm ahead of it; z of the camera is x of the base.
MOUNTED = RigidTransform(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.array([0.2, 0, 0.1]))


class Drive:
    """A robot on a walk, over DDS alone: clock, TF by way of a base, depth and images."""

    def __init__(self, robot, tmp_path):
        rng = np.random.default_rng(4)
        walked = walk('box', rng, 40)
        self.robot, self.sent, self.surfaces = robot, 0, walked.surfaces
        self.scenes = [walked.scene(k, WALK_CAMERA, rng) for k in range(IMAGES)]
        self.poses = with_errors(walked.poses[:IMAGES], 'drift', rng)
        self.node = start(robot, use_sim_time=True, **{
            'depth.source': 'topic', 'target_frame': 'odom', 'map.enabled': True,
            'map.file': str(tmp_path / 'map.json')})
        robot.publish('/tf_static', transform('base_link', FRAME_ID, MOUNTED, 0.0), STATIC)

    def go(self, begin_s):
        """Send all images from a time on, each when the one before is done."""
        for k, (scene, pose) in enumerate(zip(self.scenes, self.poses, strict=True)):
            stamp_s = begin_s + STEP_S * k
            self.robot.publish('/clock', Clock(clock=header(stamp_s).stamp))
            self.robot.publish('/tf', transform(
                'odom', 'base_link', pose.after(MOUNTED.inverse()), stamp_s))
            send(self.robot, scene, stamp_s, depth=True)
            self.sent += 1
            self.robot.wait_for('labels', self.sent)
        self.robot.spin(lambda: self.robot.received['map'] and self.robot.received['map'][-1]
                        .header.stamp == header(stamp_s).stamp, 10.0)

    def check(self):
        """Check that each surface in the last image is one plane, where the last pose sees it."""
        rows, labels, scene = cloud_array(self.robot.received['map'][-1])[0], [], self.scenes[-1]
        for k, (*normal_camera, offset_m) in enumerate(scene.planes):
            if (scene.labels == k).mean() < 0.05:
                continue
            normal = self.poses[-1].rotation @ normal_camera
            d_m = offset_m - normal @ self.poses[-1].translation_m
            cosines = np.column_stack([rows[f'normal_{axis}'] for axis in 'xyz']) @ normal
            (row,) = rows[(abs(rows['d'] - d_m) < 0.02) & (cosines > np.cos(np.radians(2)))]
            labels.append(int(row['label']))
        assert len(labels) >= 3
        return labels


def transform(parent, child, pose, stamp_s):
    return transform_msg(parent, child, pose.translation_m.tolist(), pose.quaternion.tolist(),
                         stamp_s)


@pytest.fixture
def drive(robot, tmp_path, monkeypatch):
    """Return a robot whose node hears TF by a stand-in for tf2_ros, which is not in pip."""
    monkeypatch.delitem(sys.modules, 'tf2_ros', raising=False)
    monkeypatch.syspath_prepend(Path(map_file_faults.__file__).parent / 'tf_stand_in')
    hear(robot)
    yield Drive(robot, tmp_path)
    sys.modules.pop('tf2_ros', None)


def test_a_walk_with_tf_in_simulated_time_that_is_looped(robot, drive):
    """Each surface stays one plane when time jumps back; who comes late gets the same map."""
    drive.go(1.0)
    labels = drive.check()
    drive.go(1.0)
    assert drive.check() == labels
    robot.node.create_subscription(PointCloud2, '/plane_detector/map/planes',
                                   robot.received['late'].append, LATCHED)
    (late,) = robot.wait_for('late')
    assert late == robot.received['map'][-1]
    # A transform may come before the node has seen that time has jumped, and forgets it.
    assert int(robot.diagnosis()[1]['map_images_without_pose']) <= 1


def test_a_walk_that_is_paused_goes_on_in_the_same_map(robot, drive):
    drive.go(1.0)
    labels = drive.check()
    assert change_state(robot, Transition.TRANSITION_DEACTIVATE)
    assert change_state(robot, Transition.TRANSITION_ACTIVATE)
    drive.go(10.0)
    assert drive.check() == labels
