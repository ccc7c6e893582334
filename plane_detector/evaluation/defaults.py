# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The parameters as a yaml file and as a table in the documentation, generated from config.py, and
the table of the fields of ``~/planes``, from plane_fields.py.

    python -m plane_detector.evaluation.defaults
"""

from __future__ import annotations

import json
import textwrap
from itertools import groupby
from pathlib import Path
from typing import Any

from plane_detector.config import Config, NodeConfig
from plane_detector.planes.plane_table import documented
from plane_detector.settings import parameters_of

_HEADER = """\
# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
#
# Every parameter with its default; made from plane_detector/config.py by `make defaults`.
"""
# What users set first: the source of depth, the images, and what makes depth metric.
FIRST = ('depth.source', 'depth.model', 'image_transport', 'scale.camera_height', 'scale.gravity')
_BEGIN, _END = '<!-- {}: made by `make defaults` -->', '<!-- end of {} -->'
_ROOT = Path(__file__).resolve().parents[2]


def yaml_text() -> str:
    """Return the content of config/plane_detector.yaml."""
    lines = [_HEADER.rstrip(), '/**:', '  ros__parameters:', '    # What matters first:', '']
    settings = _settings()
    for name in FIRST:
        lines += _yaml_setting(name, *settings[name], indent=4)
    others = [name for name in settings if name not in FIRST]
    for group, names in groupby(others, key=lambda name: name.rpartition('.')[0]):
        lines += [f'    {group}:'] if group else ['', '    # All the others:', '']
        for name in names:
            lines += _yaml_setting(name.rpartition('.')[2], *settings[name],
                                   indent=6 if group else 4)
    return '\n'.join(lines) + '\n'


def _yaml_setting(name: str, meta: Any, value: Any, indent: int) -> list[str]:
    """Return the lines of one setting: its description as comment, then name and value."""
    margin = ' ' * indent
    return [*textwrap.wrap(_description(meta), width=99, initial_indent=margin + '# ',
                           subsequent_indent=margin + '# ', break_on_hyphens=False),
            f'{margin}{name}: {_yaml(value)}']


def parameter_table() -> str:
    """Return the parameters as a Markdown table."""
    lines = ['| parameter | default | unit | range | meaning |', '|---|---|---|---|---|']
    for name, (meta, value) in _settings().items():
        cells = (f'`{name}`', f'`{_yaml(value)}`', meta['unit'], _range(meta),
                 meta['doc'] + ('; read when the node is configured' if meta['read_only'] else ''))
        lines.append('| ' + ' | '.join(cell.replace('|', '\\|') for cell in cells) + ' |')
    return '\n'.join(lines) + '\n'


def with_table(page: str, subject: str, table: str) -> str:
    """
    Return a page with a new table of a subject.

    Raises
    ------
    ValueError
        The two comments that enclose the table are missing.

    """
    first, last = _BEGIN.format(subject), _END.format(subject)
    head, begin, rest = page.partition(first)
    _, end, tail = rest.partition(last)
    if not (begin and end):
        raise ValueError(f'the page lacks the lines {first} and {last}')
    return f'{head}{first}\n\n{table}\n{last}{tail}'


def _settings() -> dict[str, tuple[Any, Any]]:
    """Return metadata and default of each setting by its name; those of the node first."""
    return {name: (field.metadata, value) for part in (NodeConfig(), Config())
            for name, field, value in parameters_of(part)}


def _description(meta: Any) -> str:
    notes = [f'in {meta["unit"]}' if meta['unit'] else '', _range(meta),
             'read when the node is configured' if meta['read_only'] else '']
    known = '; '.join(note for note in notes if note)
    return meta['doc'] + (f' ({known})' if known else '')


def _range(meta: Any) -> str:
    if meta['choices']:
        return 'one of ' + ', '.join(meta['choices'])
    low, high = (limit if limit is None else str(limit) if isinstance(limit, int) else f'{limit:g}'
                 for limit in (meta['low'], meta['high']))
    if low and high:
        return f'{low} to {high}'
    return f'from {low}' if low else f'to {high}' if high else ''


def _yaml(value: Any) -> str:
    """Return the value as YAML. JSON is valid YAML except for floats: 1e-06 needs a point."""
    if isinstance(value, tuple):
        return '[' + ', '.join(_yaml(item) for item in value) + ']'
    if isinstance(value, float):
        text = repr(value)
        return text if '.' in text or 'e' not in text else text.replace('e', '.0e')
    return json.dumps(value)


def main() -> None:
    """Write the yaml file and the tables to their files."""
    (_ROOT / 'config' / 'plane_detector.yaml').write_text(yaml_text(), encoding='utf-8')
    for name, subject, table in (('parameters.md', 'parameters', parameter_table()),
                                 ('topics.md', 'fields of planes', documented())):
        page = _ROOT / 'docs' / name
        page.write_text(with_table(page.read_text(encoding='utf-8'), subject, table),
                        encoding='utf-8')


if __name__ == '__main__':
    main()
