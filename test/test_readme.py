# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What the README promises holds."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / 'README.md').read_text(encoding='utf-8')
LINES = TEXT.splitlines()


def blocks(language: str) -> list[str]:
    return re.findall(rf'```{language}\n(.*?)```', TEXT, re.DOTALL)


def test_snippet_finds_the_wall_it_speaks_of(capsys):
    snippet, = blocks('python')
    names: dict = {}
    exec(compile(snippet, 'README.md', 'exec'), names)
    promised = [line.split('# ')[1] for line in snippet.splitlines() if 'print(' in line][:2]
    assert capsys.readouterr().out.splitlines()[:2] == promised
    assert len(names['found'].labels) == 480
    assert len(names['found'].planes) == 1


def test_picture_and_commands_come_early():
    assert any(line.startswith('![') for line in LINES[:14])
    assert any(line.startswith('make demo') for line in LINES[:34])


def test_links_lead_somewhere():
    links = [link for link in re.findall(r'\]\(([^)#]+)\)', TEXT) if '://' not in link]
    assert len(links) > 8
    for link in links:
        assert (ROOT / link).exists(), link


def test_make_targets_exist():
    makefile = (ROOT / 'Makefile').read_text(encoding='utf-8')
    for target in set(re.findall(r'`?make (\w+)', TEXT)):
        assert re.search(rf'^{target}:', makefile, re.MULTILINE), target


def test_every_output_of_the_node_is_in_the_table():
    from plane_detector.ros.outputs.topics import OUTPUTS
    for name, output in OUTPUTS.items():
        row, = (line for line in LINES if line.startswith(f'| `~/{name}` |'))
        assert output.msg_type.__name__ in row
