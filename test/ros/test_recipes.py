# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The recipes and the messages in the docs agree with the code."""

import re
from pathlib import Path

import pytest
import yaml
from ros_helpers import bare_node

from plane_detector.config import Config, NodeConfig
from plane_detector.ros.outputs.topics import OUTPUTS
from plane_detector.ros.parameters import declare, updated, warn_of_unknown
from plane_detector.tools.replay.options import load_settings

ROOT = Path(__file__).resolve().parents[2]
RECIPES = sorted((ROOT / 'config').glob('recipe_*.yaml'))
PARAMETER_FILES = [path for path in RECIPES if 'nav2' not in path.name]


@pytest.mark.parametrize('path', PARAMETER_FILES, ids=lambda path: path.name)
def test_the_node_and_the_replay_take_the_parameters(path, monkeypatch):
    warnings = []
    with bare_node('plane_detector', ('--params-file', str(path))) as node:
        monkeypatch.setattr(node.get_logger(), 'warning', warnings.append)
        config, settings = declare(node, Config()), declare(node, NodeConfig())
        warn_of_unknown(node)
    assert warnings == []
    assert (config, settings) == load_settings(path, ())
    assert (config, settings) != (updated(Config(), []), updated(NodeConfig(), []))


def test_the_costmap_reads_an_output_that_there_is():
    text = (ROOT / 'config' / 'recipe_nav2_costmap.yaml').read_text('utf-8')
    layers = yaml.safe_load(text)['local_costmap']['local_costmap']['ros__parameters']
    for name in layers['plugins']:
        assert layers[name]['plugin'].startswith('nav2_costmap_2d::')
    layer = layers['voxel_layer']
    assert layer['z_voxels'] <= 16, 'the most that a voxel layer has'
    assert layer['mark_threshold'] == 0, 'with n, obstacles in n voxels are left out'
    assert layer['min_obstacle_height'] < 0, 'its default of 0 hides obstacles down a ramp'
    for name in layer['observation_sources'].split():
        source = layer[name]
        output = OUTPUTS[source['topic'].removeprefix('/plane_detector/')]
        assert output.msg_type.__name__ == source['data_type']
        assert source['sensor_frame'] == '', 'the frame of the points, unless target_frame is set'
        assert source['clearing'] and source['marking'] == (name == 'obstacles')
        assert source.get('obstacle_max_range', 0.0) <= source['raytrace_max_range']
        assert source['max_obstacle_height'] <= layer['z_voxels'] * layer['z_resolution']
    drops = layers['drop_layer'][layers['drop_layer']['observation_sources']]
    assert drops['topic'].removeprefix('/plane_detector/') in OUTPUTS
    assert drops['marking'] and not drops['clearing'], 'rays pass over the edge'
    assert layers['drop_layer']['min_obstacle_height'] < 0, 'its default of 0 hides lower edges'


def messages():
    page = (ROOT / 'docs' / 'troubleshooting.md').read_text('utf-8')
    return re.findall(r'^\| `([^`]+)` \|', page, re.MULTILINE)


@pytest.fixture(scope='module')
def strings_of_the_code():
    """Return the sources with what joins strings over lines taken out."""
    text = '\n'.join(path.read_text('utf-8') for path in (ROOT / 'plane_detector').rglob('*.py'))
    return re.sub(r"'\s*\n\s*(?:\+ )?f?'", '', text)


@pytest.mark.parametrize('message', messages())
def test_explained_messages_exist_in_the_code(message, strings_of_the_code):
    assert message in strings_of_the_code
