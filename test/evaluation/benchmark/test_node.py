# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The benchmark of the node: real process, real DDS, tables of numbers."""

import os
import sys

import pytest
import rclpy

from plane_detector.config import DepthConfig
from plane_detector.evaluation.benchmark import node as benchmark_node
from plane_detector.evaluation.benchmark.node_load import median_stages, scheduled_ms
from plane_detector.ros.outputs.topics import OUTPUTS
from plane_detector.tools.demo.node_process import use_private_domain

TOPIC = [('depth topic', DepthConfig(source='topic'))]


def rows(printed):
    """Return the cells of the lines of the only table but its head."""
    lines = [line for line in printed.splitlines() if line.startswith('| ')]
    return [[cell.strip() for cell in line.strip('|').split('|')] for line in lines[2:]]


def test_the_running_node_is_measured(monkeypatch, capsys):
    for name in ('ROS_DOMAIN_ID', 'ROS_AUTOMATIC_DISCOVERY_RANGE',
                 'FASTRTPS_DEFAULT_PROFILES_FILE'):
        monkeypatch.setenv(name, os.environ.get(name, ''))  # restored after the test
    monkeypatch.delenv('FASTRTPS_DEFAULT_PROFILES_FILE')
    monkeypatch.setattr(benchmark_node, 'SUBSCRIPTIONS', {'all': tuple(OUTPUTS)})
    use_private_domain()
    rclpy.init()
    try:
        benchmark_node.report_load(TOPIC, rate_hz=5.0, seconds=3.0)
    finally:
        rclpy.try_shutdown()
    (row,) = rows(capsys.readouterr().out)
    assert row[:2] == ['depth topic', 'all']
    assert 0 < float(row[2]) < 6
    *stages, total = map(float, row[3:15])
    assert 0 < total == pytest.approx(sum(stages), abs=1 + 0.1 * total)
    on_a_core_ms, waiting_ms = float(row[16]), float(row[17])
    assert on_a_core_ms + waiting_ms > 0.3 * total, 'the threads of the process are found'


def test_stages_and_messages_are_measured_without_dds(monkeypatch, capsys):
    monkeypatch.setattr(benchmark_node, '_REPEATS', 2)
    benchmark_node.report_in_process(TOPIC)
    (row,) = rows(capsys.readouterr().out)
    numbers = [float(cell) for cell in row[1:]]
    assert numbers[-2] == pytest.approx(sum(numbers[:-2]), abs=0.5)
    assert 0 < numbers[-1] < numbers[-2]
    benchmark_node.report_messages()
    made = {name: (float(ms), float(size)) for name, ms, size in rows(capsys.readouterr().out)}
    assert set(made) == {f'~/{name}' for name in OUTPUTS}
    assert made['~/points'][1] == pytest.approx(640 * 480 * 20 / 1e6, rel=0.001)
    assert all(ms > 0 for ms, _ in made.values())


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


def test_a_network_that_is_not_there_is_named(monkeypatch, capsys):
    def missing(name):
        raise FileNotFoundError('no way to get it')
    monkeypatch.setattr(benchmark_node, 'fetch', missing)
    assert [name for name, _ in benchmark_node.sources('fastdepth')] == ['depth topic']
    assert 'fastdepth: absent, no way to get it' in capsys.readouterr().out
    assert [name for name, _ in benchmark_node.sources('none')] == ['depth topic']
