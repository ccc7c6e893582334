# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Planes as detections, with a stand-in for vision_msgs, which is not among the wheels."""

import importlib.util
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import output_scene as scene
import pytest
from ros_helpers import cloud_array

from plane_detector.ros.outputs import detections, topics

NAMES = ('BoundingBox3D', 'Detection3D', 'Detection3DArray', 'ObjectHypothesis')


class Hypothesis(SimpleNamespace):
    """Has a pose with covariance, as that of vision_msgs."""

    def __init__(self, hypothesis):
        super().__init__(hypothesis=hypothesis, pose=SimpleNamespace())


def loaded_anew(module, monkeypatch):
    """Return a copy of a module, imported now."""
    spec = importlib.util.spec_from_file_location('anew', module.__file__)
    copy = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(copy)
    monkeypatch.setitem(sys.modules, module.__name__, copy)
    return copy


@pytest.fixture
def outputs(monkeypatch):
    """Return the table of outputs where vision_msgs is installed."""
    messages = ModuleType('vision_msgs.msg')
    messages.ObjectHypothesisWithPose = Hypothesis
    for name in NAMES:
        setattr(messages, name, type(name, (SimpleNamespace,), {}))
    monkeypatch.setitem(sys.modules, 'vision_msgs', ModuleType('vision_msgs'))
    monkeypatch.setitem(sys.modules, 'vision_msgs.msg', messages)
    loaded_anew(detections, monkeypatch)
    return loaded_anew(topics, monkeypatch).OUTPUTS


@pytest.mark.parametrize('to_target', [None, scene.TARGET], ids=['camera', 'target'])
def test_a_detection_has_class_confidence_label_and_rectangle(outputs, to_target):
    frame = scene.frame(to_target=to_target)
    msg = outputs['detections'].make(frame)
    assert msg.header == frame.target_header
    rows = cloud_array(outputs['planes'].make(frame))[0]
    for found, row, kind in zip(msg.detections, rows, ('wall', 'floor'), strict=True):
        result, = found.results
        assert (result.hypothesis.class_id, result.hypothesis.score) == (kind, 0.75)
        assert (found.id, found.header) == (str(row['label']), frame.target_header)
        centre, turn = found.bbox.center.position, found.bbox.center.orientation
        np.testing.assert_allclose(
            [centre.x, centre.y, centre.z, turn.x, turn.y, turn.z, turn.w],
            [row[f'rect_{name}'] for name in ('x', 'y', 'z', 'qx', 'qy', 'qz', 'qw')], atol=1e-5)
        size = found.bbox.size
        np.testing.assert_allclose([size.x, size.y, size.z],
                                   [row['rect_width'], row['rect_height'], 0], atol=1e-5)
        assert result.pose.pose.position.x == pytest.approx(row['x'], abs=1e-5)


def test_without_vision_msgs_there_is_no_such_output(monkeypatch):
    monkeypatch.setitem(sys.modules, 'vision_msgs', None)
    loaded_anew(detections, monkeypatch)
    found = loaded_anew(topics, monkeypatch).OUTPUTS
    assert 'detections' not in found and 'planes_json' in found
