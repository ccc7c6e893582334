# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Without a lifecycle manager: retried if that can help, or ended with an exit code."""

import pytest
from node_helpers import start

from plane_detector.ros import detector_node, transitions
from plane_detector.ros.diagnostics import introduction
from plane_detector.ros.spinning import CannotRunError


@pytest.fixture
def tries(monkeypatch):
    """Let the pipeline be made at the third try only, and return the errors to come."""
    errors = [ConnectionError('unreachable'), FileNotFoundError('unreachable')]
    make = detector_node.PlaneDetector

    def make_detector(*arguments):
        if errors:
            raise errors.pop()
        return make(*arguments)

    monkeypatch.setattr(detector_node, 'PlaneDetector', make_detector)
    monkeypatch.setattr(transitions, 'FIRST_PAUSE_S', 0.05)
    return errors


def test_temporary_failures_are_retried_after_growing_pauses(robot, tries):
    node = start(robot, lambda rgb: None, wait=False)
    assert robot.spin(lambda: node.state == 'active')
    assert robot.log().count('unreachable') == 2
    assert not robot.diagnosis()[1]['state'].startswith('unconf')


def test_a_wrong_setting_is_not_retried(robot, tries):
    tries[:] = [ValueError('no provider runs')] * 5
    node = start(robot, lambda rgb: None, wait=False)
    assert robot.is_logged('no provider runs')
    robot.spin(timeout_s=0.5)
    assert node.state == 'unconfigured'
    assert len(tries) == 4


def test_with_exit_on_failure_the_spinning_ends_after_the_reason(robot, tries):
    start(robot, lambda rgb: None, wait=False, exit_on_failure=True)
    with pytest.raises(CannotRunError, match='exit_on_failure is true'):
        robot.spin(timeout_s=5.0)
    assert robot.is_logged('cannot be configured: unreachable')


def test_the_log_at_configure_is_three_lines():
    facts = {'depth_model': 'a network', 'depth_model_reason': 'as requested',
             'execution_provider': 'on a GPU'}
    topics = {'image': '/image', 'camera_info': '/camera_info'}
    assert introduction(facts, topics, '/plane_detector/planes') == [
        'depth from a network, on a GPU', 'as requested',
        '/image, /camera_info -> /plane_detector/planes and the other outputs']
