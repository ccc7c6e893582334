# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""One program with subcommands: each has a help, and wrong input is explained in one line."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
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
    root = Path(__file__).resolve().parents[3]
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


def test_wrong_input_ends_a_process_with_a_line():
    run = subprocess.run([sys.executable, '-m', MODULE, 'depth', 'no_such_network'],
                         capture_output=True, text=True, check=False)
    assert run.returncode == 1
    assert 'Traceback' not in run.stderr
    assert 'no_such_network' in run.stderr


def test_the_provenance_of_a_result_is_stated():
    text = program.provenance(['scale', 'with space'])
    assert text.startswith(f"`python3 -m {MODULE} scale 'with space'`\n\n")
    for part in ('cores, Python 3.', f'numpy {np.__version__}', '; commit '):
        assert part in text
