# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The benchmark of the node: real process, real DDS, tables of numbers."""

import os
import sys

import numpy as np
import pytest
import rclpy
from frame_files import write_frame

from plane_detector.config import DepthConfig
from plane_detector.evaluation.benchmark import node as benchmark_node
from plane_detector.evaluation.benchmark.node_load import Show, median_stages, scheduled_ms
from plane_detector.evaluation.benchmark.node_process import use_private_domain
from plane_detector.evaluation.datasets import Frame
from plane_detector.ros.outputs.topics import OUTPUTS

TOPIC = [('depth topic', DepthConfig(source='topic'))]


def views(room):
    """Return two rooms as the camera shows them, whose lines tell where down is."""
    return [Frame('rooms', str(seed), scene.rgb, scene.depth_m, scene.intrinsics)
            for seed, scene in ((seed, room(seed)) for seed in (3, 5))]


def rows(printed):
    """Return the cells of the lines of the only table but its head."""
    lines = [line for line in printed.splitlines() if line.startswith('| ')]
    return [[cell.strip() for cell in line.strip('|').split('|')] for line in lines[2:]]


@pytest.fixture
def ros(monkeypatch):
    for name in ('ROS_DOMAIN_ID', 'ROS_AUTOMATIC_DISCOVERY_RANGE',
                 'FASTRTPS_DEFAULT_PROFILES_FILE'):
        monkeypatch.setenv(name, os.environ.get(name, ''))  # restored after the test
    monkeypatch.delenv('FASTRTPS_DEFAULT_PROFILES_FILE')
    use_private_domain()
    rclpy.init()
    yield
    rclpy.try_shutdown()


def test_the_running_node_is_measured(ros, room, monkeypatch, capsys):
    monkeypatch.setattr(benchmark_node, 'SUBSCRIPTIONS', {'all': tuple(OUTPUTS)})
    benchmark_node.report_load(TOPIC, Show('two rooms', views(room), 5.0, motion_px=8), 3.0)
    printed = capsys.readouterr().out
    assert 'moved by 8 px' in printed
    (row,) = rows(printed)
    assert row[:2] == ['depth topic', 'all']
    assert 0 < float(row[2]) < 6
    *stages, total = map(float, row[3:15])
    assert 0 < total == pytest.approx(sum(stages), abs=1 + 0.1 * total)
    on_a_core_ms, waiting_ms, camera_ms, receiver_ms = map(float, row[16:20])
    assert on_a_core_ms + waiting_ms > 0.3 * total, 'the threads of the process are found'
    assert camera_ms > 0
    assert receiver_ms > 0


def test_the_camera_shows_a_set_of_the_data_folder(tmp_path):
    title, (view,) = benchmark_node.views_of(tmp_path, 'room')
    assert 'room' in title
    assert view.depth_m.shape == view.rgb.shape[:2]
    with pytest.raises(FileNotFoundError, match='no set street'):
        benchmark_node.views_of(tmp_path, 'street')
    write_frame(tmp_path / 'desk', np.full((120, 160), 2000, np.uint16))
    title, (read,) = benchmark_node.views_of(tmp_path, 'desk')
    assert '1 frames of desk' in title
    np.testing.assert_allclose(read.depth_m, 2.0)


def test_a_second_without_frames_does_not_count():
    idle = {'latency.total_ms': '0.00', 'rate_hz': '0.00'}
    busy = [{'latency.depth_ms': f'{ms}', 'latency.total_ms': f'{ms}'} for ms in (1.0, 2.0, 9.0)]
    assert median_stages([idle, *busy]) == {'depth': 2.0, 'total': 2.0}
    assert median_stages([idle]) == {}


@pytest.mark.skipif(sys.platform != 'linux', reason='reads /proc')
def test_the_time_on_a_core_grows_with_work():
    before_ms = scheduled_ms(os.getpid())
    sum(range(2_000_000))
    assert (scheduled_ms(os.getpid()) - before_ms)[0] > 1


def test_an_unavailable_network_is_named(monkeypatch, capsys):
    def missing(name):
        raise FileNotFoundError('no way to get it')
    monkeypatch.setattr(benchmark_node, 'fetch', missing)
    assert [name for name, _ in benchmark_node.sources('fastdepth', 30.0)] == ['depth topic']
    assert 'fastdepth: absent, no way to get it' in capsys.readouterr().out
    assert [name for name, _ in benchmark_node.sources('none', 30.0)] == ['depth topic']
