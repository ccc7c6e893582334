# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Detection of silent topics, their reason, and a single log line."""

from types import SimpleNamespace

import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image

from plane_detector.ros.inputs.topic_watch import TopicWatch, explain_loss, explain_silence

RELIABLE, BEST_EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
IMAGE, COMPRESSED = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage'


class Graph:
    """A node that knows these publishers, by topic and type, and keeps its log."""

    def __init__(self, **publishers):
        self.published = {f'/{name}': kind for name, kind in publishers.items()}
        self.reliability = RELIABLE
        self.warnings, self.infos = [], []

    def get_logger(self):
        return SimpleNamespace(warning=self.warnings.append, info=self.infos.append)

    def get_fully_qualified_name(self):
        return '/plane_detector'

    def get_publishers_info_by_topic(self, topic):
        profile = QoSProfile(depth=1, reliability=self.reliability)
        return [SimpleNamespace(topic_type=kind, qos_profile=profile)
                for name, kind in self.published.items() if name == topic]

    def get_topic_names_and_types(self):
        return [(name, [kind]) for name, kind in self.published.items()]

    def count_publishers(self, topic):
        return topic in self.published


class Clock:
    """A clock set by the test."""

    now_s = 100.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


def watch_of(graph, clock):
    watch = TopicWatch(graph, clock)
    watch.add('image', '/image', Image)
    watch.add('camera_info', '/camera_info', CameraInfo, may_stop=True)
    return watch


@pytest.mark.parametrize('interval_s, still_alive_s', [(0.03, 1.9), (4.0, 11.0), (20.0, 59.0)])
def test_a_stopped_camera_and_its_return_are_logged_once(clock, interval_s,
                                                                     still_alive_s):
    graph = Graph()
    watch = watch_of(graph, clock)
    watch.heard('camera_info')
    watch.heard('image')
    for _ in range(4):
        clock.now_s += interval_s
        watch.heard('image')
        assert watch.problem() == '', 'however slow it is'
    clock.now_s += still_alive_s
    assert watch.problem() == ''
    for _ in range(3):
        clock.now_s += 3.0
        assert '/image has stopped' in watch.problem()
    assert len(graph.warnings) == 1
    watch.heard('image')
    assert watch.problem() == ''
    assert graph.infos == ['messages arrive on /image']


@pytest.mark.parametrize('topic, type_name, offered, published, told', [
    ('/image', IMAGE, [], {}, 'nobody publishes /image, nor any other topic of type '
                              'sensor_msgs/msg/Image'),
    ('/image', IMAGE, [], {'/cam/image_raw/compressed': COMPRESSED},
     '/cam/image_raw/compressed is a sensor_msgs/msg/CompressedImage: set image_transport to '
     'compressed'),
    ('/image/compressed', COMPRESSED, [], {'/cam/image/compressed': COMPRESSED},
     '-r image:=/cam/image'),
    ('/cam/compressed', IMAGE, [COMPRESSED], {}, 'set image_transport to compressed and remap '
                                                 'image to /cam'),
    ('/image/compressed', COMPRESSED, [IMAGE], {}, 'set image_transport to raw'),
    ('/image', IMAGE, ['std_msgs/msg/String'], {}, 'is published as std_msgs/msg/String, not as '
                                                   'sensor_msgs/msg/Image')])
def test_the_reason_is_told_with_the_remedy(topic, type_name, offered, published, told):
    assert told in explain_silence('image', topic, type_name, offered, published)


@pytest.mark.parametrize('offered, only_reliable, told', [
    ([RELIABLE, RELIABLE], True, 'nothing arrives on /image, though it has 2 publisher(s)'),
    ([BEST_EFFORT], False, 'config/fastdds_large_messages.xml'),
    ([BEST_EFFORT], True, 'the parameter input_reliability asks for reliable')])
def test_messages_that_do_not_arrive_are_explained_by_what_the_publishers_offer(
        offered, only_reliable, told):
    assert told in explain_loss('/image', offered, only_reliable)


def test_a_new_publisher_has_two_seconds_for_its_first_message(clock):
    graph = Graph(camera_info='sensor_msgs/msg/CameraInfo')
    watch = watch_of(graph, clock)
    watch.heard('camera_info')
    clock.now_s += 10.0
    assert 'nobody publishes /image' in watch.problem()
    graph.published['/image'] = IMAGE
    watch.problem()
    clock.now_s += 1.9
    watch.problem()
    assert len(graph.warnings) == 1
    clock.now_s += 0.2
    assert 'nothing arrives on /image, though it has 1 publisher' in watch.problem()
    watch.heard('image')
    assert watch.problem() == ''
    assert graph.infos == ['messages arrive on /image']
