# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The defaults that users read are those of config.py."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from plane_detector.config import Config, NodeConfig
from plane_detector.evaluation import defaults as parameters
from plane_detector.settings import parameters_of

ROOT = Path(__file__).resolve().parents[2]
YAML = ROOT / 'config' / 'plane_detector.yaml'
DEFAULTS = {name: value for part in (NodeConfig(), Config())
            for name, _, value in parameters_of(part)}


def flattened(tree: dict, prefix: str = '') -> dict:
    flat = {}
    for name, value in tree.items():
        flat |= (flattened(value, f'{prefix}{name}.') if isinstance(value, dict)
                 else {prefix + name: value})
    return flat


def test_yaml_holds_every_default_with_its_type():
    loaded = flattened(yaml.safe_load(YAML.read_text(encoding='utf-8'))['/**']['ros__parameters'])
    assert set(loaded) == set(DEFAULTS)
    for name, default in DEFAULTS.items():
        value = tuple(loaded[name]) if isinstance(default, tuple) else loaded[name]
        assert value == default, name
        assert type(value) is type(default), name


def test_yaml_file_is_as_generated():
    assert YAML.read_text(encoding='utf-8') == parameters.yaml_text(), 'run `make defaults`'


def test_table_is_as_generated():
    page = (ROOT / 'docs' / 'parameters.md').read_text(encoding='utf-8')
    assert page == parameters.with_table(page), 'run `make defaults`'
    for name in DEFAULTS:
        assert page.count(f'| `{name}` |') == 1


def test_node_takes_the_yaml_file_as_its_defaults():
    rclpy = pytest.importorskip('rclpy')
    from rclpy.context import Context
    from rclpy.node import Node

    from plane_detector.ros.parameters import declare
    context = Context()
    rclpy.init(args=['--ros-args', '--params-file', str(YAML)], context=context)
    try:
        node = Node('plane_detector', context=context)
        assert declare(node, Config()) == Config()
        assert declare(node, NodeConfig()) == NodeConfig()
        node.destroy_node()
    finally:
        rclpy.shutdown(context=context)
