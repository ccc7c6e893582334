# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Statistics of a checkout: modules, import floors, constants, lines, long functions.

It only reads the sources, so that it can also count a checkout of another commit:

    git worktree add ../before COMMIT
    python3 -m plane_detector.evaluation.benchmark structure ../before .
"""

from __future__ import annotations

import argparse
import ast
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from plane_detector.evaluation.benchmark.tables import emit, table

PACKAGE = 'plane_detector'
# Layers that are not installed.
NOT_INSTALLED = ('evaluation',)
MOST_LINES, MOST_ARGUMENTS = 40, 6
ORIGINS = ('derived', 'after', 'tuned')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of this subcommand."""
    parser.add_argument('checkouts', nargs='*', type=Path, default=[Path('.')],
                        help='folders that contain a plane_detector, one column each')
    parser.add_argument('--segmentation', nargs='*', default=[], metavar='MODULE',
                        help='modules of the segmentation, if it has no folder of its own')


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    columns = [counts(checkout / PACKAGE, options.segmentation)
               for checkout in options.checkouts]
    rows = [[name, *(str(column[name]) for column in columns)] for name in columns[0]]
    emit('### Structure', table(('count', *map(str, options.checkouts)), rows),
         'Constants are the numbers at the top of modules; functions are counted from def to the '
         'last line, with their docstring. Rooms are the folders and files at the top of the '
         'package; the floors are the longest chain of imports.')


def counts(package: Path, segmentation: Sequence[str] = ()) -> dict[str, int]:
    """
    Count a package.

    Parameters
    ----------
    package : Path
        Its folder.
    segmentation : sequence of str
        Modules that belong to the segmentation, if there is no folder of this name.

    Returns
    -------
    dict of str to int
        Counts in the order of the table.

    """
    paths, imported = sorted(package.rglob('*.py')), imports(package)
    installed = [path for path in paths
                 if path.relative_to(package).parts[0] not in NOT_INSTALLED]
    folder = package / 'segmentation'
    inside = sorted(folder.rglob('*.py')) if folder.is_dir() else [
        package / f'{name}.py' for name in segmentation]
    return {
        'modules': len(paths),
        'modules that are installed': len(installed),
        'modules in the top folder': sum(path.parent == package for path in paths),
        'lines that are installed': _lines(installed),
        'rooms': len(rooms(imported)),
        'import floors of the rooms': max(floors(rooms(imported)).values(), default=0),
        'import floors of the modules': max(floors(imported).values(), default=0),
        'lines of the segmentation': _lines(inside),
        **_constant_counts(inside), **_function_counts(paths)}


def _constant_counts(paths: Sequence[Path]) -> dict[str, int]:
    origins = Counter(origin for path in paths for _, origin in constants(path))
    return {'constants of the segmentation': sum(origins.values()),
            **{f'... that are {origin}': origins[origin] for origin in ORIGINS},
            '... without an origin': origins['']}


def _function_counts(paths: Sequence[Path]) -> dict[str, int]:
    functions = [node for path in paths for node in ast.walk(_tree(path))
                 if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))]
    lengths = [node.end_lineno - node.lineno + 1 for node in functions]
    return {
        f'functions over {MOST_LINES} lines': sum(count > MOST_LINES for count in lengths),
        f'functions over {MOST_ARGUMENTS} arguments': sum(
            _argument_count(node) > MOST_ARGUMENTS for node in functions)}


def constants(path: Path) -> Iterator[tuple[str, str]]:
    """Yield the name of each numeric constant of a module, and its origin, empty if none."""
    lines = path.read_text(encoding='utf-8').splitlines()
    for node in _tree(path).body:
        if isinstance(node, ast.Assign) and _is_numeric(node.value):
            above = node.lineno - 1
            while lines[above - 1].startswith('#'):
                above -= 1
            comment = ' '.join([*lines[above:node.lineno - 1], lines[node.end_lineno - 1]])
            found = re.search(rf'# ({"|".join(ORIGINS)}):', comment)
            for target in ast.walk(node.targets[0]):
                if isinstance(target, ast.Name) and target.id.isupper():
                    yield target.id, found[1] if found else ''


def imports(package: Path) -> dict[str, set[str]]:
    """Return the modules that each module of a package imports, all by their full names."""
    names = {'.'.join(path.relative_to(package.parent).with_suffix('').parts)
             .removesuffix('.__init__'): path for path in package.rglob('*.py')}
    found = {}
    for name, path in names.items():
        wanted = set()
        for node in ast.walk(_tree(path)):
            if isinstance(node, ast.Import):
                wanted |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                wanted |= {node.module, *(f'{node.module}.{alias.name}' for alias in node.names)}
        found[name] = (wanted & set(names)) - {name, package.name}
    return found


def rooms(imported: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """Return the imports among rooms: folders and files at the top level of the package."""
    found: dict[str, set[str]] = {}
    for name, others in imported.items():
        if '.' in name:
            room = name.split('.')[1]
            found.setdefault(room, set()).update(other.split('.')[1] for other in others)
    return {room: others - {room} for room, others in found.items()}


def floors(imported: Mapping[str, set[str]]) -> dict[str, int]:
    """
    Return the length of the longest chain of imports below each module, including itself.

    Examples
    --------
    >>> floors({'node': {'pipeline', 'config'}, 'pipeline': {'config'}, 'config': set()})
    {'node': 3, 'pipeline': 2, 'config': 1}

    """
    known: dict[str, int] = {}

    def floor(name: str, above: tuple[str, ...] = ()) -> int:
        if name not in known:
            # A module already in the chain closes a circle, which does not add to the length.
            below = [floor(other, (*above, name)) for other in imported[name]
                     if other not in above]
            known[name] = 1 + max(below, default=0)
        return known[name]

    return {name: floor(name) for name in imported}


def _is_numeric(value: ast.expr) -> bool:
    """Return whether an expression consists of numeric literals: 3, 1 / 12, (2, 3), an array."""
    nodes = list(ast.walk(value))
    numbers = [node for node in nodes if isinstance(node, ast.Constant)]
    names = {node.id for node in nodes if isinstance(node, ast.Name)}
    return bool(numbers) and names <= {'np'} and all(
        type(node.value) in (int, float) for node in numbers) and not any(
        isinstance(node, (ast.Subscript, ast.Dict, ast.JoinedStr)) for node in nodes)


def _argument_count(node: ast.FunctionDef) -> int:
    arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    return sum(argument.arg not in ('self', 'cls') for argument in arguments)


def _lines(paths: Sequence[Path]) -> int:
    return sum(len(path.read_text(encoding='utf-8').splitlines()) for path in paths)


def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding='utf-8'))
