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
from plane_detector.ros.diagnostics import Report, Statistics
from plane_detector.ros.health import Health
from plane_detector.ros.network_pace import fit_to_rate, slow_network


def report(depth_s, arrival_hz):
    return Report(10, 0, 0, 1.0, {'depth': depth_s}, arrival_hz=arrival_hz)


def advise(share):
    return f'a share of {share:.2f}'


@pytest.mark.parametrize(('depth_s', 'arrival_hz'), [
    (0.1, 9.0), (0.1, 10.5), (0.1, 0.0), (0.0, 30.0)])
def test_a_fast_network_is_not_reported(depth_s, arrival_hz):
    assert slow_network(report(depth_s, arrival_hz), advise) == ''


def test_a_slow_network_is_reported_with_advice():
    assert slow_network(report(0.2, 10.0), advise) == (
        'the network takes 200 ms, the camera sends an image every 100 ms: a share of 0.50')
    assert slow_network(report(0.2, 10.0), lambda share: '') == '', 'no network, no advice'
    assert slow_network(Report(0, 0, 0, 0.0), advise) == ''


def test_all_arriving_frames_are_counted():
    statistics = Statistics()
    statistics.report()
    statistics.add_processed({'depth': 0.1})
    statistics.add_dropped(3)
    found = statistics.report()
    assert found.arrival_hz == pytest.approx(4 * found.rate_hz)
    assert statistics.report().arrival_hz == 0


def test_the_warning_is_logged_once():
    class Logger(list):
        warning = list.append
    logger = Logger()
    health = Health(logger)
    for text in ('takes 200 ms', 'takes 210 ms'):
        health.tell_once('network_pace', text)
    assert logger == ['takes 200 ms']


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


@pytest.mark.parametrize('rate_hz, source', [(0.0, 'model'), (5.0, 'topic')])
def test_without_a_rate_or_a_network_nothing_is_timed(monkeypatch, rate_hz, source):
    assert fitted(monkeypatch, rate_hz, source) == ([], [])


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
