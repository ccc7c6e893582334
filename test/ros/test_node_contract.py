# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The docstring of the node names its topics and services."""

import pytest
from node_helpers import start

from plane_detector.ros.detector_node import PlaneDetectorNode
from plane_detector.ros.outputs.topics import OUTPUTS


@pytest.mark.parametrize('name', OUTPUTS)
def test_every_output_is_named(name):
    assert f'~/{name}' in PlaneDetectorNode.__doc__


def test_every_service_and_input_of_the_node_is_named(robot):
    node = start(robot, lambda rgb: None, use_imu=True)
    own = [service.srv_name for service in node.services if service.srv_name.startswith('~')]
    assert own
    for name in (*own, 'image', 'camera_info', 'imu', 'clicked_point'):
        assert name in PlaneDetectorNode.__doc__, name
