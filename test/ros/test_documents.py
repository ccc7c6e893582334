# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What the documents and the yaml file say of the node is what it does."""

import importlib
import re

import pytest
from documents import README, ROOT, commands, text_of, uses
from ros_helpers import bare_node

from plane_detector.config import Config, NodeConfig
from plane_detector.planes.plane_table import documented
from plane_detector.ros.outputs.clouds import CORNER_DTYPE, SHAPE_DTYPE
from plane_detector.ros.outputs.topics import OUTPUTS
from plane_detector.ros.parameters import declare
from plane_detector.settings import parameters_of

TOPICS = ROOT / 'docs' / 'topics.md'


@pytest.mark.parametrize('page', [README, TOPICS], ids=lambda page: page.name)
def test_every_output_of_the_node_is_in_the_tables(page):
    for name, output in OUTPUTS.items():
        rows = [line for line in page.read_text('utf-8').splitlines()
                if line.startswith(f'| `~/{name}` |')]
        assert len(rows) == 1, name
        assert output.msg_type.__name__ in rows[0]


def test_every_field_of_planes_and_shapes_is_in_the_tables():
    text = TOPICS.read_text('utf-8')
    assert documented() in text, 'run `make defaults`'
    for field in (*SHAPE_DTYPE.names, *CORNER_DTYPE.names):
        assert re.search(rf'^\|[^|]*`{field}`', text, re.MULTILINE), field


def test_every_key_of_the_diagnostics_is_in_the_table():
    section = text_of(TOPICS).split('### Diagnostics')[1].split('\n### ')[0]
    folder = ROOT / 'plane_detector' / 'ros'
    keys = {key for path in folder.glob('*.py')
            for key in re.findall(r"(?:facts|values)\['(\w+)'\]|'(map_\w+)': ", text_of(path))}
    names = {name for pair in keys for name in pair if name}
    assert {'drops', 'mounting', 'map_planes', 'images_received'} <= names
    assert {name for name in names if f'`{name}`' not in section} == set()


def test_parameters_that_are_given_in_commands_exist():
    known = {name for part in (Config(), NodeConfig()) for name, _, _ in parameters_of(part)}
    given = [(page, words[k + 1].split(':=')[0]) for page, words in commands()
             for k, word in enumerate(words[:-1])
             if word == '-p' and ':=' in words[k + 1] and 'plane_detector' in ' '.join(words)]
    assert len(given) > 4
    for page, name in given:
        assert name in known, f'{page}: {name}'


def test_node_takes_the_yaml_file_as_its_defaults():
    path = ROOT / 'config' / 'plane_detector.yaml'
    with bare_node('plane_detector', ('--params-file', str(path))) as node:
        assert declare(node, Config()) == Config()
        assert declare(node, NodeConfig()) == NodeConfig()


@pytest.mark.parametrize('program', ['replay', 'show', 'fetch', 'rviz', 'export', 'demo'])
def test_options_of_programs_are_in_their_help(program, capsys):
    """Of each command of the documents: as ros2 run and as python -m start them."""
    entry = re.search(rf"f'{program} = {{NAME}}\.([\w.]+):main'", text_of(ROOT / 'setup.py'))[1]
    main = importlib.import_module(f'plane_detector.{entry}').main
    with pytest.raises(SystemExit):
        main(['--help'])
    explained = capsys.readouterr().out
    module = f'plane_detector.{entry}'.removesuffix('.__main__')
    used = uses('ros2', 'run', 'plane_detector', program) + uses('-m', module)
    if program == 'demo':  # make hands its variables over as options
        used += [(page, [f'--{word.split("=")[0].lower()}' for word in words if '=' in word])
                 for page, words in uses('make', 'demo')]
    assert used
    for page, words in used:
        for option in (word.split('=')[0] for word in words if word.startswith('-')):
            if option == '--ros-args':
                break
            assert re.search(rf'(?<![\w-]){option}(?![\w-])', explained), f'{page}: {option}'
