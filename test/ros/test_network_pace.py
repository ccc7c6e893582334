# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The node reports a network that is slower than the camera, with advice."""

import pytest

pytest.importorskip('rclpy')

from node_helpers import start
from onnx_models import write_depth_network


def test_log_and_diagnostics_name_the_choice(robot, tmp_path):
    path = write_depth_network(tmp_path / 'n.onnx')
    start(robot, depth__model=str(path), depth__output='metric_depth', depth__short_side=140,
          depth__target_rate=1000.0, depth__input_scale=1.0, depth__mean=[0.0] * 3,
          depth__std=[1.0] * 3)
    values = {}
    while values.get('state') != 'active':  # a status may have been on its way before
        values = robot.diagnosis()[1]
    assert 'depth.target_rate 1000 Hz' in values['network_input_reason']
    assert ' x ' in values['network_input']
    assert values['network_input_reason'] in robot.log()
