# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""README.md and docs/ are correct: links, commands, snippets, tables."""

import importlib
import importlib.util
import re
import subprocess
from dataclasses import fields

import pytest
from documents import PAGES, README, ROOT, blocks, commands, text_of, uses

from plane_detector import PAGES as PAGES_PLACE

LINES = README.read_text(encoding='utf-8').splitlines()
MOST_README_LINES = 150


def test_readme_is_short_with_image_and_command_early():
    assert len(LINES) <= MOST_README_LINES
    assert any(line.startswith('![') for line in LINES[:14])
    assert any(line.startswith('make demo') for line in LINES[:29])


@pytest.mark.parametrize('page', [*PAGES, *sorted((ROOT / '.github').glob('*.md'))],
                         ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    for link in re.findall(r'\]\(([^)#]+)(?:#[^)]*)?\)', text_of(page)):
        if '://' not in link:
            assert (page.parent / link).exists(), link


def test_every_page_is_linked_from_the_readme():
    linked = set(re.findall(r'\]\(docs/([^)#]+)\)', text_of(README)))
    assert {page.name for page in PAGES[1:]} <= linked


def test_snippet_finds_the_described_wall(capsys):
    snippet, = blocks(README, 'python')
    names: dict = {}
    exec(compile(snippet, 'README.md', 'exec'), names)
    promised = [line.split('# ')[1] for line in snippet.splitlines() if 'print(' in line][:2]
    assert capsys.readouterr().out.splitlines()[:2] == promised
    assert len(names['detection'].labels) == 480
    assert len(names['detection'].planes) == 1


def test_make_targets_exist():
    makefile = text_of(ROOT / 'Makefile')
    used = [(page, words[1:]) for page, words in commands() if words[0] == 'make']
    assert len(used) > 5
    for page, words in used:
        for target in [word for word in words if '=' not in word][:1]:
            assert re.search(rf'^{target}:', makefile, re.MULTILINE), f'{page}: make {target}'


def test_programs_are_entry_points():
    setup = text_of(ROOT / 'setup.py')
    used = uses('ros2', 'run', 'plane_detector')
    assert len(used) > 2
    for page, (program, *_) in used:
        assert f"f'{program} = " in setup, f'{page}: {program}'


def test_modules_that_are_started_exist():
    used = [(page, words[0]) for page, words in uses('-m') if words]
    assert len(used) > 2
    for page, module in used:
        assert importlib.util.find_spec(module), f'{page}: {module}'


def test_launch_file_and_its_arguments_exist():
    text = (ROOT / 'launch' / 'plane_detector.launch.py').read_text('utf-8')
    arguments_of_file = ['cameras', *re.findall(r"^    '(\w+)': \(", text, re.MULTILINE)]
    used = uses('ros2', 'launch', 'plane_detector')
    assert used
    for page, (name, *arguments) in used:
        assert (ROOT / 'launch' / name).exists(), f'{page}: {name}'
        for argument in [word.split(':=')[0] for word in arguments if ':=' in word]:
            assert argument in arguments_of_file, f'{page}: {argument}'


def test_installed_files_that_are_named_exist():
    """Below the share folder are config, launch and the examples, which are in docs here."""
    named = {name for page in PAGES
             for name in re.findall(r'--share plane_detector\)/([\w./]+)', text_of(page))}
    assert len(named) > 2
    for name in named:
        assert (ROOT / name.replace('examples/', 'docs/examples/')).exists(), name


def test_parameters_that_are_named_exist():
    from plane_detector.config import Config
    known = {f'{part.name}.{setting.name}' for part in fields(Config)
             for setting in fields(getattr(Config(), part.name))}
    groups = {name.split('.')[0] for name in known if '.' in name}
    for page in PAGES:
        for name in re.findall(r'`([a-z_]+\.[a-z_]+)(?::[^`]*)?`', text_of(page)):
            # planes.csv is a file, whatever sections there are.
            if name.split('.')[0] in groups and not name.endswith(('.csv', '.md', '.py')):
                assert name in known, f'{page.name}: {name}'


def test_commits_that_are_named_are_in_the_history():
    def git(*words):
        return subprocess.run(['git', '-C', str(ROOT), *words], capture_output=True, text=True,
                              check=False)

    if git('rev-parse', '--is-shallow-repository').stdout.strip() != 'false':
        pytest.skip('not in a clone with its history')
    sources = sorted((ROOT / 'plane_detector').rglob('*.py'))
    # Frames of the kitchen are called f000150.
    named = {(page.name, commit) for page in (*PAGES, *sources)
             for commit in re.findall(r'\b(?!f\d{6})(?=\d*[a-f])[0-9a-f]{7}\b', text_of(page))}
    assert len(named) > 50
    known = set(git('log', '--format=%h', '--abbrev=7').stdout.split())
    assert {(name, commit) for name, commit in named if commit not in known} == set()


def test_pages_that_messages_name_are_installed():
    setup = text_of(ROOT / 'setup.py')
    assert "(f'share/{NAME}/docs', sorted(glob('docs/*.md')))" in setup
    assert PAGES_PLACE.endswith('--share plane_detector)/docs')
    named = {page for path in (ROOT / 'plane_detector').rglob('*.py')
             for page in re.findall(r'\{PAGES\}/([\w.]+)', text_of(path))}
    assert {'topics.md', 'parameters.md'} <= named
    assert named <= {page.name for page in PAGES}


def rows_of(text: str, method: str) -> list[list[str]]:
    """Return the cells of all rows of tables that begin with a method."""
    return [[cell.strip() for cell in line.strip().strip('|').split('|')][1:]
            for line in text.splitlines() if line.startswith(f'| {method} |')]


@pytest.mark.parametrize('method', ['plane_detector', 'OpenCV findPlanes, 5 cm',
                                    'paper, 20000 points'])
def test_results_in_the_readme_are_those_of_the_page(method):
    sections = re.split(r'^### ', text_of(ROOT / 'docs' / 'results.md'), flags=re.MULTILINE)
    tables = [rows_of(section, method)[0] for title in ('Rooms', 'Lived-in rooms')
              for section in sections
              if section.startswith(f'{title}: SC / recall / precision by noise')]
    covering = [[cell.split(' / ')[0] for cell in row[1:]] for row in tables]
    shown, = rows_of(text_of(README), method)
    assert shown == [cell for row in covering for cell in (row[0], row[2], row[4], row[5])]
