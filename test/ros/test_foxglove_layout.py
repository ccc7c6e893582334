# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The Foxglove layout shows existing topics in panels."""

import json
from pathlib import Path

from plane_detector.ros.diagnostics import HARDWARE_ID
from plane_detector.ros.outputs.topics import OUTPUTS

REPOSITORY = Path(__file__).resolve().parents[2]
TOPICS = {f'/plane_detector/{name}' for name in OUTPUTS} | {'/diagnostics'}


def leaves(layout):
    """Return the panels of a layout, which is one or a pair of layouts."""
    if isinstance(layout, str):
        return {layout}
    return leaves(layout['first']) | leaves(layout['second'])


def test_the_layout_shows_overlay_cloud_markers_and_state():
    text = (REPOSITORY / 'config' / 'foxglove_layout.json').read_text(encoding='utf-8')
    layout = json.loads(text)
    panels = layout['configById']
    assert leaves(layout['layout']) == set(panels)
    shown = set()
    for panel in panels.values():
        shown |= {topic for topic, view in panel.get('topics', {}).items() if view['visible']}
        assert set(panel.get('topics', {})) <= TOPICS
        shown |= {panel.get('cameraTopic'), panel.get('topicToRender'),
                  panel.get('topicPath', '').partition('.')[0] or None}
    shown.discard(None)
    assert shown <= TOPICS
    assert shown >= {'/plane_detector/overlay', '/diagnostics', '/plane_detector/points',
                     '/plane_detector/markers'}


def test_the_panels_are_of_types_that_old_and_new_viewers_have():
    """Newer viewers turn an ImageViewPanel into their Image panel; older ones have no other."""
    layout = json.loads((REPOSITORY / 'config' / 'foxglove_layout.json').read_text('utf-8'))
    assert {name.partition('!')[0] for name in layout['configById']} == {
        'ImageViewPanel', '3D', 'DiagnosticStatusPanel', 'RawMessages'}


def test_the_cloud_has_its_own_colours():
    """As in the overlay: one palette everywhere, with points_color label."""
    layout = json.loads((REPOSITORY / 'config' / 'foxglove_layout.json').read_text('utf-8'))
    points = layout['configById']['3D!planes']['topics']['/plane_detector/points']
    assert (points['colorMode'], points['colorField']) == ('rgb', 'rgb')


def test_the_panel_of_the_state_finds_node_and_replay_by_their_hardware_id():
    layout = json.loads((REPOSITORY / 'config' / 'foxglove_layout.json').read_text('utf-8'))
    panel = layout['configById']['DiagnosticStatusPanel!state']
    assert panel['selectedHardwareId'] == HARDWARE_ID
    assert 'selectedName' not in panel, 'the node may have any name'
