# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The layout of Foxglove and Lichtblick shows existing topics in panels that both have."""

import json
from pathlib import Path

import pytest

from plane_detector.ros.outputs.topics import OUTPUTS

REPOSITORY = Path(__file__).resolve().parents[2]
TOPICS = {f'/plane_detector/{name}' for name in OUTPUTS} | {'/diagnostics'}


@pytest.fixture
def layout():
    return json.loads((REPOSITORY / 'config' / 'foxglove_layout.json').read_text('utf-8'))


def leaves(layout):
    """Return the panels of a layout, which is one or a pair of layouts."""
    if isinstance(layout, str):
        return {layout}
    return leaves(layout['first']) | leaves(layout['second'])


def test_overlay_cloud_markers_planes_and_state_are_shown(layout):
    panels = layout['configById']
    assert leaves(layout['layout']) == set(panels)
    # An ImageViewPanel is of no known type since 2023.
    assert {name.partition('!')[0] for name in panels} == {'Image', '3D', 'DiagnosticStatusPanel'}
    for panel in panels.values():
        assert panel['foxglovePanelTitle'] == panel['lichtblickPanelTitle']
    assert panels['Image!overlay']['imageMode']['imageTopic'] == '/plane_detector/overlay'
    topics = panels['3D!planes']['topics']
    assert set(topics) <= TOPICS
    assert {topic for topic, view in topics.items() if view['visible']} == {
        '/plane_detector/points', '/plane_detector/markers'}
    points = topics['/plane_detector/points']
    assert (points['colorMode'], points['colorField']) == ('rgb', 'rgb'), 'see points_color'
