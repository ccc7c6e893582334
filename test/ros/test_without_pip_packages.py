# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""With measured depth, the node and its tests do without the packages that only pip has."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from node_helpers import assert_true_to, points_and_planes, send, small_room
from ros_helpers import STARTED_S, NodeProcess, Robot, cloud_array, next_domain

ROOT = Path(__file__).resolve().parents[2]
HIDDEN = "import sys; sys.modules.update(dict.fromkeys(('onnxruntime', 'rosbags')))"


@pytest.fixture(scope='module')
def hidden(tmp_path_factory):
    """Hide both packages from new processes."""
    folder = tmp_path_factory.mktemp('hidden')
    (folder / 'sitecustomize.py').write_text(HIDDEN)
    with pytest.MonkeyPatch.context() as changed:
        changed.setenv('PYTHONPATH', str(folder))
        changed.setenv('FASTRTPS_DEFAULT_PROFILES_FILE',
                       str(ROOT / 'config' / 'fastdds_large_messages.xml'))
        yield folder


@pytest.fixture(scope='module', autouse=True)
def collecting(hidden):
    """Collect all tests, beside the first ones here."""
    with subprocess.Popen(
            [sys.executable, '-m', 'pytest', '--collect-only', '-q', str(ROOT / 'test')], cwd=ROOT,
            stdout=subprocess.PIPE, text=True) as process:
        yield process


def test_planes_from_measured_depth(hidden):
    domain = next_domain()
    node = NodeProcess(['-p', 'depth.source:=topic'], domain, hidden / 'node.log')
    robot = Robot(outputs=('points', 'planes'), domain=domain)
    try:
        for stamp_s in range(int(STARTED_S)):  # until the node is there and has been found
            send(robot, small_room(), stamp_s, depth=True)
            if robot.spin(lambda: points_and_planes(robot), 1.0):
                break
        assert robot.spin(lambda: points_and_planes(robot)), node.log()
        points, planes = points_and_planes(robot)
        assert_true_to(small_room(), planes, cloud_array(points)['label'])
        assert robot.diagnosis()[1]['depth_model'] == 'the depth topic, no network'
        assert node.end(signal.SIGTERM) == 0
    finally:
        robot.shutdown()
        node.process.kill()
        node.process.wait()


def test_a_network_without_its_runtime_is_explained(hidden):
    domain = next_domain()
    node = NodeProcess(['-p', 'depth.model:=fastdepth'], domain, hidden / 'network.log')
    try:
        node.wait_until(lambda: 'onnxruntime' in node.log() and node.process.poll() is not None)
        assert "pip install 'onnxruntime>=" in node.log()
    finally:
        node.process.kill()
        node.process.wait()


def test_no_test_needs_them_to_be_collected(collecting):
    printed = collecting.communicate()[0]
    assert collecting.returncode == 0, printed
    assert 'ONNX Runtime, which networks need, is not installed' in printed
    assert 'rosbags, which replay needs, is not installed' in printed
