# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Count what a checkout is made of: modules, import floors, constants, lines, long functions.

It reads the sources only, so that it also counts a checkout of another commit:

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
# The layers that a robot does not get installed.
NOT_INSTALLED = ('evaluation',)
MOST_LINES, MOST_ARGUMENTS = 40, 6
ORIGINS = ('derived', 'after', 'tuned')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of this subcommand."""
    parser.add_argument('checkouts', nargs='*', type=Path, default=[Path('.')],
                        help='folders with a plane_detector in them, a column each')
    parser.add_argument('--segmentation', nargs='*', default=[], metavar='MODULE',
                        help='modules of the segmentation where it has no folder of its own')


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
        Modules in it that are the segmentation, where there is no folder of this name.

    Returns
    -------
    dict of str to int
        What is counted, in the order of the table.

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
    """Yield the name of each number at the top of a module, and its origin, empty if none."""
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
    """Return which modules of a package each of them imports, all by their full names."""
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
    """Return which rooms, folders and files at the top of the package, import each other."""
    found: dict[str, set[str]] = {}
    for name, others in imported.items():
        if '.' in name:
            room = name.split('.')[1]
            found.setdefault(room, set()).update(other.split('.')[1] for other in others)
    return {room: others - {room} for room, others in found.items()}


def floors(imported: Mapping[str, set[str]]) -> dict[str, int]:
    """
    Return how many modules the longest chain of imports below each module has, itself included.

    Examples
    --------
    >>> floors({'node': {'pipeline', 'config'}, 'pipeline': {'config'}, 'config': set()})
    {'node': 3, 'pipeline': 2, 'config': 1}

    """
    known: dict[str, int] = {}

    def floor(name: str, above: tuple[str, ...] = ()) -> int:
        if name not in known:
            # A module that is above already closes a circle, which adds nothing.
            below = [floor(other, (*above, name)) for other in imported[name]
                     if other not in above]
            known[name] = 1 + max(below, default=0)
        return known[name]

    return {name: floor(name) for name in imported}


def _is_numeric(value: ast.expr) -> bool:
    """Say whether an expression is of numbers written out: 3, -1e-3, 1 / 12, (2, 3), an array."""
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
