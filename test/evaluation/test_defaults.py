# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Defaults that users read are those of config.py, planted errors those that the docs list."""

from __future__ import annotations

import re
from pathlib import Path

import yaml

from plane_detector.config import Config, NodeConfig
from plane_detector.evaluation import defaults as parameters
from plane_detector.evaluation.plant_errors import ERRORS, TESTS, part_of
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
    assert parameters.parameter_table() in page, 'run `make defaults`'
    for name in DEFAULTS:
        assert page.count(f'| `{name}` |') == 1


def test_every_error_can_be_planted():
    for file, errors in ERRORS.items():
        assert part_of(file) in TESTS
        for right, wrong, _ in errors:
            assert (ROOT / 'plane_detector' / file).read_text('utf-8').count(right) == 1, right
            assert right != wrong


def test_the_table_of_the_docs_names_a_test_for_each_error():
    rows = re.findall(r'^\| (\w+) \| ([^|]+) \| (\S+) \| `(\w+)` in (\S+) \|$',
                      (ROOT / 'docs' / 'development.md').read_text('utf-8'), re.MULTILINE)
    assert {(part, wrong, file) for part, wrong, file, _, _ in rows} == {
        (part_of(file), wrong, file) for file, errors in ERRORS.items() for *_, wrong in errors}
    for *_, name, tests in rows:
        assert f'def {name}(' in (ROOT / 'test' / tests).read_text('utf-8'), name
