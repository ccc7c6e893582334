# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Names of the input topics: remapping ``image`` also moves the topics that belong to it."""

from __future__ import annotations

from typing import Protocol

COMPRESSED = '/compressed'


class Resolver(Protocol):
    """The part of a node that is used: resolution of names."""

    def resolve_topic_name(self, topic: str, *, only_expand: bool = False) -> str:
        """Return the full name, with remappings unless ``only_expand``."""


def input_topics(node: Resolver, image_transport: str) -> dict[str, str]:
    """
    Return the full names of the inputs, by the names used for remapping.

    The compressed topic follows ``image``, as in image_transport, and ``camera_info`` is in the
    namespace of the image, unless they are remapped themselves.

    Parameters
    ----------
    node : rclpy.node.Node
        Resolves the names.
    image_transport : str
        ``raw`` or ``compressed``.

    """
    base = node.resolve_topic_name('image').removesuffix(COMPRESSED)
    image = node.resolve_topic_name('image')
    if image_transport == 'compressed':
        image = base + COMPRESSED
        if _is_remapped(node, 'image/compressed'):
            image = node.resolve_topic_name('image/compressed')
            base = image.removesuffix(COMPRESSED)
    camera_info = node.resolve_topic_name('camera_info')
    if not _is_remapped(node, 'camera_info'):
        camera_info = f'{base.rpartition("/")[0]}/camera_info'
    return {'image': image, 'camera_info': camera_info,
            **{role: node.resolve_topic_name(role) for role in ('depth', 'imu')}}


def _is_remapped(node: Resolver, topic: str) -> bool:
    return node.resolve_topic_name(topic) != node.resolve_topic_name(topic, only_expand=True)
