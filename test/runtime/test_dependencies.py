# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Declared, pinned and locked packages agree; one that is missing or too old is named."""

import ast
import re
from pathlib import Path

import pytest

from plane_detector._runtime.dependencies import REMEDIES

ROOT = Path(__file__).resolve().parents[2]


def plain(name):
    return re.sub(r'[-_.]+', '-', name).lower()


def pinned(path):
    """Return the versions by name of a requirements file."""
    lines = re.findall(r'^([A-Za-z][\w.-]*)(?:\[[\w,]+\])?==([^\s;\\]+)', path.read_text(), re.M)
    return {plain(name): version for name, version in lines}


@pytest.fixture(scope='module')
def locked():
    return pinned(ROOT / '.ci' / 'requirements.lock')


@pytest.mark.parametrize('name', ['requirements.txt', 'constraints.txt'])
def test_the_lock_contains_all_pinned_packages(locked, name):
    """Otherwise `make lock` must be run."""
    wanted = pinned(ROOT / '.ci' / name)
    assert len(wanted) > 10
    assert {key: locked.get(key) for key in wanted} == wanted


def test_every_locked_version_has_hashes():
    text = (ROOT / '.ci' / 'requirements.lock').read_text()
    entries = re.split(r'^(?=[A-Za-z])', text, flags=re.M)[1:]
    assert len(entries) > 100
    assert [entry.split()[0] for entry in entries if '--hash=sha256:' not in entry] == []


def test_installed_packages_are_pinned(locked):
    """Of the package's own requirements; their bounds allow the pinned version."""
    calls = [node for node in ast.walk(ast.parse((ROOT / 'setup.py').read_text()))
             if isinstance(node, ast.keyword) and node.arg == 'install_requires']
    requirements = [*ast.literal_eval(calls[0].value), 'onnxruntime>=1.22']
    for requirement in requirements:
        name, _, bound = requirement.partition('>=')
        version = locked[plain(name)]
        numbers = [[int(part) for part in text.split('.')[:3]] for text in (version, bound or '0')]
        assert numbers[0] >= numbers[1], requirement


def test_oldest_versions_are_those_of_the_installation():
    setup = (ROOT / 'setup.py').read_text()
    bounds = dict(re.findall(r"'([\w-]+)>=([\d.]+)'", setup))
    named = dict(re.findall(r"'([\w-]+)>=([\d.]+)'", ' '.join(REMEDIES.values())))
    assert named == bounds
