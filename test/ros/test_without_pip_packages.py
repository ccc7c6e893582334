# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""With measured depth, the node and its tests do without the packages that only pip has."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from node_helpers import assert_true_to, send, small_room
from ros_helpers import STARTED_S, NodeProcess, Robot, cloud_array, random_domain

ROOT = Path(__file__).resolve().parents[2]
HIDDEN = "import sys; sys.modules.update(dict.fromkeys(('onnxruntime', 'rosbags')))"


@pytest.fixture
def hidden(tmp_path, monkeypatch):
    """Hide both packages from new processes."""
    (tmp_path / 'sitecustomize.py').write_text(HIDDEN)
    monkeypatch.setenv('PYTHONPATH', str(tmp_path))
    monkeypatch.setenv('FASTRTPS_DEFAULT_PROFILES_FILE',
                       str(ROOT / 'config' / 'fastdds_large_messages.xml'))
    return tmp_path


def test_planes_from_measured_depth(hidden):
    domain = random_domain()
    node = NodeProcess(['-p', 'depth.source:=topic'], domain, hidden / 'node.log')
    robot = Robot(outputs=('points', 'planes'), domain=domain)
    try:
        for stamp_s in range(int(STARTED_S)):  # until the node is there and has been found
            send(robot, small_room(), stamp_s, depth=True)
            if robot.spin(lambda: robot.received['points'] and robot.received['planes'], 1.0):
                break
        points, planes = (robot.wait_for(name)[-1] for name in ('points', 'planes'))
        assert_true_to(small_room(), planes, cloud_array(points)['label'])
        assert robot.diagnosis()[1]['depth_model'] == 'the depth topic, no network'
    finally:
        robot.shutdown()
        node.process.kill()
        node.process.wait()


def test_a_network_without_its_runtime_is_explained(hidden):
    domain = random_domain()
    node = NodeProcess(['-p', 'depth.model:=fastdepth'], domain, hidden / 'node.log')
    try:
        node.wait_until(lambda: 'onnxruntime' in node.log() and node.process.poll() is not None)
        assert "pip install 'onnxruntime>=" in node.log()
    finally:
        node.process.kill()
        node.process.wait()


def test_no_test_needs_them_to_be_collected(hidden):
    done = subprocess.run(
        [sys.executable, '-m', 'pytest', '--collect-only', '-q', str(ROOT / 'test')], cwd=ROOT,
        env=os.environ, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert 'ONNX Runtime, which networks need, is not installed' in done.stdout
    assert 'rosbags, which replay needs, is not installed' in done.stdout
