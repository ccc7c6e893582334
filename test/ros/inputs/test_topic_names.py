# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Topics that follow a remapped image, and topics that are remapped themselves."""

import pytest
import rclpy
from rclpy.node import Node

from plane_detector.ros.inputs.subscriptions import input_topics


@pytest.fixture
def topics_of():
    """Return a function: transport and remaps -> image and camera_info of a real node."""
    opened = []

    def topics(transport, *remaps, namespace=''):
        context = rclpy.Context()
        arguments = [word for remap in remaps for word in ('-r', remap)]
        rclpy.init(context=context, domain_id=78,
                   args=['--ros-args', *arguments] if remaps else [])
        node = Node('camera', context=context, namespace=namespace)
        opened.append((context, node))
        names = input_topics(node, transport)
        return names['image'], names['camera_info']

    yield topics
    for context, node in opened:
        node.destroy_node()
        context.try_shutdown()


@pytest.mark.parametrize('transport, remaps, expected', [
    ('raw', (), ('/image', '/camera_info')),
    ('raw', ('image:=/cam/color/image_raw',), ('/cam/color/image_raw', '/cam/color/camera_info')),
    ('raw', ('image:=/cam/image', 'camera_info:=/other/info'), ('/cam/image', '/other/info')),
    ('raw', ('image:=image_raw',), ('/image_raw', '/camera_info')),
    ('compressed', (), ('/image/compressed', '/camera_info')),
    ('compressed', ('image:=/cam/image_raw',), ('/cam/image_raw/compressed', '/cam/camera_info')),
    ('compressed', ('image:=/cam/image_raw/compressed',),
     ('/cam/image_raw/compressed', '/cam/camera_info')),
    ('compressed', ('image/compressed:=/cam/jpeg',), ('/cam/jpeg', '/cam/camera_info'))])
def test_names(topics_of, transport, remaps, expected):
    assert topics_of(transport, *remaps) == expected


def test_names_in_a_namespace(topics_of):
    assert topics_of('raw', namespace='front') == ('/front/image', '/front/camera_info')
