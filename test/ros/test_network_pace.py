# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The node reports a network that is slower than the camera, with advice."""

import pytest

pytest.importorskip('rclpy')

from node_helpers import small_room, start
from onnx_models import write_depth_network

from plane_detector import Config, PlaneDetector
from plane_detector.config import DepthConfig
from plane_detector.ros import network_pace
from plane_detector.ros.network_pace import fit_to_rate


def fitted(monkeypatch, rate_hz, source='model'):
    """Return what a detector is asked to fit to, and the frames that were processed for it."""
    asked, made = [], []
    process = network_pace.FrameProcessor.process
    monkeypatch.setattr(network_pace.FrameProcessor, 'process',
                        lambda self, frame: made.append(process(self, frame)))
    detector = PlaneDetector(Config(depth=DepthConfig(source=source, target_rate=rate_hz)),
                             lambda rgb: small_room().depth_m)
    detector.source.fit_to_rate = lambda *given: asked.append(given)
    fit_to_rate(detector)
    return asked, made


def test_all_that_a_frame_needs_beside_the_network_is_timed(monkeypatch):
    ((rate_hz, other_s),), (made, *_) = fitted(monkeypatch, 5.0)
    found = made.result.detection
    assert rate_hz == 5.0
    assert other_s > 0
    assert set(made.messages) >= {'planes', 'points', 'overlay/compressed'}
    assert found.gravity_source == 'image', 'the lines of the image are found too'
    assert len(found.planes) >= 3, 'four faces of the corridor and its end'
    assert found.disparity_noise > 0.001


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
