# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
What builds, checks and ships the package can be read, and agrees with the package.

Workflows and containers cannot be run by a test; they are parsed.
"""

import json
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
WORKFLOWS = sorted((ROOT / '.github' / 'workflows').glob('*.yaml'))
MANIFEST = ElementTree.parse(ROOT / 'package.xml')
VERSION = MANIFEST.findtext('version')


def read(*parts):
    return ROOT.joinpath(*parts).read_text(encoding='utf-8')


def jobs():
    return [pytest.param(job, id=f'{path.stem}-{name}') for path in WORKFLOWS
            for name, job in yaml.safe_load(path.read_text())['jobs'].items()]


def test_workflows_start_by_themselves_and_may_only_read_the_repository():
    assert len(WORKFLOWS) == 4
    for path in WORKFLOWS:
        workflow = yaml.safe_load(path.read_text())
        assert 'push' in workflow[True]  # YAML 1.1 reads the key `on` as true
        assert workflow['permissions']['contents'] == 'read'


@pytest.mark.parametrize('job', jobs())
def test_jobs_end_and_their_steps_either_use_or_run(job):
    assert job['timeout-minutes'] > 0
    for step in job['steps']:
        assert ('uses' in step) != ('run' in step)
        assert re.fullmatch(r'[\w-]+/[\w-]+@v\d+', step.get('uses', 'a/b@v1'))
    used = set(re.findall(r'matrix\.(\w+)', json.dumps(job)))
    assert used == set(job.get('strategy', {}).get('matrix', {}))


def test_files_that_workflows_and_the_container_name_exist():
    texts = [*(path.read_text() for path in WORKFLOWS), read('.devcontainer', 'Dockerfile')]
    named = {name for text in texts
             for name in re.findall(r'(?<![\w/])\.(?:ci|devcontainer)/[\w.]+', text)}
    assert named == {'.ci/run', '.ci/requirements.txt', '.devcontainer/Dockerfile'}
    for name in named:
        assert (ROOT / name).is_file()


def test_the_container_builds_from_ros_and_starts_the_launch_file():
    lines = read('.devcontainer', 'Dockerfile').replace('\\\n', ' ').splitlines()
    words = [line.split(maxsplit=1) for line in lines if line and not line.startswith('#')]
    known = {'ARG', 'FROM', 'ENV', 'WORKDIR', 'COPY', 'RUN', 'SHELL', 'VOLUME', 'ENTRYPOINT'}
    assert {word for word, _ in words} == known
    assert ['FROM', 'ros:${DISTRIBUTION}-ros-base'] in words
    *_, package, launch = json.loads(words[-1][1])
    assert package == 'plane_detector'
    assert (ROOT / 'launch' / launch).is_file()
    container = json.loads(read('.devcontainer', 'devcontainer.json'))
    assert (ROOT / '.devcontainer' / container['build']['dockerfile']).is_file()


def test_the_hooks_use_the_ruff_that_is_pinned():
    pinned = re.search(r'^ruff==(\S+)$', read('.ci', 'requirements.txt'), re.M)[1]
    hooks, = yaml.safe_load(read('.ci', 'pre-commit.yaml'))['repos']
    assert hooks['rev'] == f'v{pinned}'


def test_rosdoc2_finds_its_settings_and_the_modules():
    path = ROOT / MANIFEST.findtext('export/rosdoc2')
    header, settings = yaml.safe_load_all(path.read_text())
    assert header == {'type': 'rosdoc2 config', 'version': 1}
    assert (ROOT / settings['settings']['python_source'] / '__init__.py').is_file()


def test_citation_is_of_this_version():
    citation = yaml.safe_load(read('CITATION.cff'))
    assert {'cff-version', 'message', 'title', 'authors', 'date-released'} <= set(citation)
    assert citation['version'] == VERSION
    assert citation['license'] == MANIFEST.findtext('license')


def test_the_changelog_has_this_version_with_its_date():
    lines = read('CHANGELOG.rst').splitlines()
    headings = [above for above, line in zip(lines, lines[1:], strict=False)
                if above and set(line) == {'-'}]
    released = yaml.safe_load(read('CITATION.cff'))['date-released']
    assert headings == ['Forthcoming', f'{VERSION} ({released})']


def test_the_aggregator_takes_both_states_of_the_node():
    settings = yaml.safe_load(read('config', 'diagnostics_aggregator.yaml'))
    analyzer = settings['analyzers']['ros__parameters']['planes']
    assert analyzer['num_items'] == 2
    name = re.search(r"'node_name': \('(\w+)'", read('launch', 'plane_detector.launch.py'))[1]
    assert analyzer['startswith'] == [name]
