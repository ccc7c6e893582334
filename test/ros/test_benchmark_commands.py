# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Each subcommand of the benchmark, one of which measures the node, has a help and a use."""

import re
import shlex
from pathlib import Path

import pytest

from plane_detector.evaluation.benchmark import __main__ as program
from plane_detector.evaluation.benchmark.__main__ import COMMANDS, main

MODULE = 'plane_detector.evaluation.benchmark'


@pytest.mark.parametrize('name', COMMANDS)
def test_every_subcommand_has_its_own_help(name, capsys):
    with pytest.raises(SystemExit, match='0'):
        main([name, '--help'])
    assert f'{MODULE} {name} ' in ' '.join(capsys.readouterr().out.split())


@pytest.mark.parametrize(('arguments', 'message'), [
    ([], 'SUBCOMMAND'), (['nothing'], 'nothing'),
    (['accuracy', '--rooms', '0'], 'at least 1'),
    (['node', '--rate', '0'], 'above 0'), (['node', '--seconds', '1'], 'at least 2')])
def test_wrong_arguments_are_explained(arguments, message, capsys):
    with pytest.raises(SystemExit, match='2'):
        main(arguments)
    assert message in capsys.readouterr().err


def commands_of_the_docs():
    """Return the words after the program's name of every command in docs/ and README.md."""
    root = Path(__file__).resolve().parents[2]
    for page in (root / 'README.md', *sorted((root / 'docs').glob('*.md'))):
        text = page.read_text(encoding='utf-8').replace('\\\n', ' ')
        for command in re.findall(rf'(?:-m\s+{re.escape(MODULE)}|\.\.\.|ARGS=")\s*([^`"#;]+)',
                                  text):
            words = shlex.split(command.split('\n\n')[0].split('\n```')[0])
            if words and words[0] in COMMANDS:
                yield words


def test_the_commands_of_the_docs_have_these_options():
    found = list(commands_of_the_docs())
    assert len(found) > 10
    for name, *options in found:
        program.subcommand(name)[1].parse_args(options)
