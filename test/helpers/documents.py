# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""README.md and docs/: their pages, and the commands in them."""

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / 'README.md'
PAGES = [README, *sorted((ROOT / 'docs').glob('*.md'))]


def text_of(page: Path) -> str:
    return page.read_text(encoding='utf-8')


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf'```{language}\n(.*?)```', text_of(page), re.DOTALL)


def commands() -> list[tuple[str, list[str]]]:
    """Return page and words of every command: of the shell blocks and of inline code."""
    found = []
    for page in PAGES:
        inline = [code.replace('\n', ' ') for code in
                  re.findall(r'(?<!`)`([^`]+)`(?!`)', re.sub(r'```.*?```', '', text_of(page),
                                                             flags=re.DOTALL))]
        lines = [line for block in blocks(page, 'bash')
                 for line in block.replace('\\\n', ' ').splitlines()]
        for line in [*lines, *inline]:
            for part in re.split(r'\s*(?:&&|;|\|)\s*', line.split(' #')[0]):
                try:
                    words = shlex.split(part, comments=True)
                except ValueError:
                    continue
                found += [(page.name, words)] if words else []
    return found


def uses(*start: str) -> list[tuple[str, list[str]]]:
    """Return page and the words after each command that starts like this."""
    return [(page, words[k + len(start):]) for page, words in commands()
            for k in range(len(words)) if tuple(words[k:k + len(start)]) == start]
