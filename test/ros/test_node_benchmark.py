# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The benchmark of the node: real process, real DDS, tables of numbers."""

import os

import numpy as np
import pytest
import rclpy

from plane_detector.config import DepthConfig
from plane_detector.evaluation.benchmark import node as benchmark_node
from plane_detector.evaluation.benchmark.node import Show, median_stages, use_private_domain
from plane_detector.evaluation.datasets import Frame
from plane_detector.evaluation.scenes.rooms import random_room
from plane_detector.ros.outputs.topics import OUTPUTS

TOPIC = [('depth topic', DepthConfig(source='topic'))]


def views():
    """Return two rooms as the camera shows them, whose lines tell where down is."""
    return [Frame('rooms', str(seed), scene.rgb, scene.depth_m, scene.intrinsics)
            for seed, scene in ((seed, random_room(np.random.default_rng(seed)))
                                for seed in (3, 5))]


def rows(printed):
    """Return the cells of the lines of the only table but its head."""
    lines = [line for line in printed.splitlines() if line.startswith('| ')]
    return [[cell.strip() for cell in line.strip('|').split('|')] for line in lines[2:]]


@pytest.fixture
def ros(monkeypatch):
    for name in ('ROS_DOMAIN_ID', 'FASTRTPS_DEFAULT_PROFILES_FILE'):
        monkeypatch.setenv(name, os.environ.get(name, ''))  # restored after the test
    monkeypatch.delenv('FASTRTPS_DEFAULT_PROFILES_FILE')
    use_private_domain()
    rclpy.init()
    yield
    rclpy.try_shutdown()


def test_the_running_node_is_measured(ros, monkeypatch, capsys):
    statuses = []
    monkeypatch.setattr(benchmark_node, 'SUBSCRIPTIONS', {'all': tuple(OUTPUTS)})
    monkeypatch.setattr(benchmark_node, 'median_stages',
                        lambda seen: statuses.extend(seen) or median_stages(seen))
    benchmark_node.report_load(TOPIC, Show('two rooms', views(), 5.0), 3.0)
    (row,) = rows(capsys.readouterr().out)
    assert row[:2] == ['depth topic', 'all']
    assert 0 < float(row[2]) < 6
    share, busy_ms, waiting_ms, median_ms, most_ms, worst_ms = (
        float(cell.rstrip('%')) for cell in row[3:9])
    assert 0 < median_ms <= most_ms <= worst_ms
    resident_mb, start_s = map(float, row[9:11])
    assert resident_mb > 50
    assert 0 < start_s < 120
    *stages, total = map(float, row[11:-1])
    assert 0 < max(stages) <= total
    seconds_ms = [[float(status.get(f'latency.{stage}_ms', 0)) for stage in benchmark_node._STAGES]
                  for status in statuses if float(status['latency.total_ms'])]
    for *stages_ms, total_ms in seconds_ms:  # their medians need not add up
        assert total_ms == pytest.approx(sum(stages_ms), abs=1 + 0.1 * total_ms)
    assert total == pytest.approx(np.median([total_ms for *_, total_ms in seconds_ms]), abs=0.06)
    assert busy_ms + waiting_ms > 0.3 * total, 'the threads of the process are found'
    assert share == pytest.approx(0.1 * busy_ms * float(row[2]), abs=1 + 0.05 * share)
