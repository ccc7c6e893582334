# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Measure every front, in one table, and compare it with the floors.

    make scores
    make scores ARGS='--only colour,vertical'
    make scores ARGS='--only measured --against HEAD~3'

The exit code is 1 if a front is below its floor by more than its spread, or could not be measured
although its requirements are met. Measurements without their data are listed as not run.
"""

from __future__ import annotations

import argparse
import datetime
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from plane_detector._runtime.compilation import compile_kernels
from plane_detector.depth.networks import NETWORKS, cached_path
from plane_detector.evaluation.benchmark.report import (
    add_shared,
    commit,
    emit,
    in_parallel,
    machine,
    table,
)
from plane_detector.evaluation.scores import colour, cost, measured, robots
from plane_detector.evaluation.scores.table import (
    Draw,
    Floor,
    Job,
    Measurement,
    Row,
    first_seed,
    read_floors,
    renewed,
    rounding,
    rows_of,
    run_job,
    write_floors,
)

FLOORS = Path(__file__).with_name('floors.csv')
ROOT = Path(__file__).parents[3]
MEASUREMENTS: tuple[Measurement, ...] = (
    *measured.MEASUREMENTS, *colour.MEASUREMENTS, *robots.MEASUREMENTS, *cost.MEASUREMENTS)
GROUPS = tuple(dict.fromkeys(one.group for one in MEASUREMENTS))
COMPILED = ('geometry', 'segmentation', 'planes', 'ground', 'network', 'mapping', 'ros')
# Takes a minute on both cores exclusively, so it runs only if it is named.
NOT_BY_DEFAULT = ('compile',)


def groups(text: str) -> list[str]:
    """Parse names of groups, separated by commas."""
    names = text.split(',')
    if wrong := [name for name in names if name not in GROUPS]:
        raise argparse.ArgumentTypeError(f'there is no group {wrong[0]!r}; there are '
                                         f'{", ".join(GROUPS)}')
    return names


def parser() -> argparse.ArgumentParser:
    """Return the parser of the options."""
    result = argparse.ArgumentParser(
        prog='python -m plane_detector.evaluation.scores', description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter)
    result.add_argument('--only', type=groups, metavar='GROUP,GROUP',
                        help=f'of {", ".join(GROUPS)}')
    result.add_argument('--against', metavar='COMMIT',
                        help='also measure that commit, and print the differences')
    result.add_argument('--seeds-from', metavar='DATE', help='a date or a number from 9000 on; '
                        'default: as the floors')
    result.add_argument('--write-floors', action='store_true',
                        help='raise floors that are exceeded by more than their spread')
    result.add_argument('--reason', default='', help='with --write-floors: also lower those that '
                        'do not hold, and why, with what was gained')
    result.add_argument('--json', type=Path, metavar='FILE', help='write all values there')
    result.add_argument('--cases', type=Path, default=Path('../shared/cases'), metavar='FOLDER',
                        help='programs that print PASS or FAIL lines; default: %(default)s')
    add_shared(result, '--data', '--processes', processes=2)
    return result


def unmet(options: argparse.Namespace) -> dict[str, str]:
    """Return the unmet requirements of measurements, with the reasons."""
    missing = {}
    if not options.data.is_dir():
        missing['data'] = f'no data, {options.data} is not there'
    if not options.cases.is_dir():
        missing['cases'] = f'no data, {options.cases} is not there'
    network = NETWORKS['fastdepth']
    if not cached_path(network).is_file():
        missing['network'] = (f'no {network.file_name} in {cached_path(network).parent}: '
                              'python -m plane_detector.tools.fetch fastdepth')
    return missing


def measure(options: argparse.Namespace, seed: int, names: Sequence[str]) -> list[Row]:
    """Run the measurements of some groups, on two processes by default."""
    chosen = [one for one in MEASUREMENTS if one.group in names]
    missing = unmet(options)
    jobs = [Job(k, one.function, Draw(seed + draw, part, options.data.resolve(),
                                      options.cases.resolve()))
            for k, one in enumerate(chosen) if not missing.keys() & set(one.needs)
            for draw in range(one.draws) for part in one.parts]
    compile_kernels(COMPILED)
    return rows_of(chosen, in_parallel(run_job, jobs, options.processes, 'scores'), missing)


def report(rows: Sequence[Row], floors: dict[str, Floor]) -> list[str]:
    """Print the table, and return the names of the fronts that fail."""
    failed = []
    for group in dict.fromkeys(row.group for row in rows):
        lines = []
        for row in (one for one in rows if one.group == group):
            floor, verdict = floors.get(row.name), 'holds'
            if row.missing:
                verdict = f'not run: {row.missing}'
            elif row.error:
                verdict = f'FAILS: {row.error}'
            elif floor is None:
                verdict = 'no floor yet'
            elif not floor.holds(row):
                verdict = 'FALLS'
            elif floor.is_exceeded(row):
                verdict = 'better: raise the floor'
            if verdict.startswith('F'):
                failed.append(row.name)
            numbers = (['-'] * 3 if not row.known.size else
                       [f'{row.value:.4g} ± {row.spread:.2g}', f'{row.worst:.3g}',
                        str(row.known.size)])
            lines.append([row.name, *numbers, '-' if floor is None else
                          f'{"≥" if row.better > 0 else "≤"} {floor.value:.4g} ± '
                          f'{floor.spread:.2g}', verdict])
        emit(f'### {group}', table(('front', 'value', 'worst', 'of', 'floor', ''), lines))
    return failed


def save(path: Path, rows: Sequence[Row]) -> None:
    """Write the values of all draws."""
    path.write_text(json.dumps([{**vars(row), 'draws': dict(row.draws)} for row in rows]))


def load(path: Path) -> list[Row]:
    """Read what :func:`save` wrote."""
    return [Row(**{**row, 'draws': {int(seed): values for seed, values in row['draws'].items()}})
            for row in json.loads(path.read_text())]


def differences(now: Sequence[Row], before: Sequence[Row], name: str) -> None:
    """Print the difference of each front from another commit, draw by draw."""
    old, lines = {row.name: row for row in before}, []
    for row in now:
        other = old[row.name]
        if row.missing or row.error or other.error or not other.known.size:
            lines.append([row.name, '-', '-', '-', row.missing or row.error
                          or f'{name} cannot run it: {other.error}'])
            continue
        pairs = [np.nanmean(row.draws[seed]) - np.nanmean(other.draws[seed])
                 for seed in row.draws if seed in other.draws]
        if len(pairs) == 1:
            # Image by image.
            (own,), (theirs,) = row.draws.values(), other.draws.values()
            pairs = np.subtract(own, theirs) if len(own) == len(theirs) else pairs
        pairs = np.asarray(pairs)[np.isfinite(pairs)]
        spread = 2 * np.std(pairs, ddof=1) / np.sqrt(len(pairs)) if len(pairs) > 1 else 0.0
        change = row.value - other.value
        word = '' if abs(change) <= spread + rounding(row.value) else (
            'better' if change * row.better > 0 else 'WORSE')
        lines.append([row.name, f'{other.value:.4g}', f'{row.value:.4g}',
                      f'{change:+.3g} ± {spread:.2g}', word])
    emit(f'### Now against {name}', table(('front', name, 'now', 'difference', ''), lines))


def measured_there(options: argparse.Namespace, folder: Path, seed: int, group: str) -> list[Row]:
    """Measure a group with the package in a folder and this program."""
    result = folder / 'scores.json'
    run = subprocess.run([
        sys.executable, '-m', 'plane_detector.evaluation.scores', '--only', group, '--seeds-from',
        str(seed), '--json', str(result), '--data', str(options.data.resolve()), '--cases',
        str(options.cases.resolve()), '--processes', str(options.processes)],
        cwd=folder, capture_output=True, text=True)
    if not result.is_file():
        last = run.stderr.strip().rpartition('\n')[2]
        sys.exit(f'scores: the fronts of {group} cannot be measured at {options.against}: {last}. '
                 'If it lacks what this program imports, run its own in a worktree of it.')
    rows = load(result)
    result.unlink()
    return rows


def compare(options: argparse.Namespace, seed: int, names: Sequence[str]) -> list[Row]:
    """Measure another commit and this one alternately, by group; return the rows of this one."""
    rows = []
    for group, other in turns(options, seed, names):
        now = measure(options, seed, [group])
        differences(now, other, options.against)
        rows += now
    return rows


def turns(options: argparse.Namespace, seed: int, names: Sequence[str]
          ) -> Iterator[tuple[str, list[Row]]]:
    """Yield each group with the rows of another commit, from a worktree that is removed."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / 'tree'
        git = ('git', '-C', str(ROOT), 'worktree')
        subprocess.run([*git, 'add', '--detach', str(folder), options.against], check=True,
                       capture_output=True)
        try:
            # Its package, with the current scenes, metrics and fronts.
            there = folder / 'plane_detector' / 'evaluation'
            shutil.rmtree(there)
            shutil.copytree(ROOT / 'plane_detector' / 'evaluation', there)
            for group in names:
                yield group, measured_there(options, folder, seed, group)
        finally:
            subprocess.run([*git, 'remove', '--force', str(folder)], check=False)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and compare; return the exit code."""
    options = parser().parse_args(arguments)
    seeds, floors = (read_floors(FLOORS) if FLOORS.is_file() else
                     (datetime.date.today().isoformat(), {}))
    given = options.seeds_from or seeds
    if given != seeds:
        emit(f'The floors are of the seeds from {seeds}, these from {given}.')
    seed = first_seed(given)
    names = options.only or [name for name in GROUPS if name not in NOT_BY_DEFAULT]
    emit(f'{machine()}; commit {commit()}; seeds from {seed} on')
    start_s = time.monotonic()
    rows = (compare if options.against else measure)(options, seed, names)
    failed = report(rows, floors)
    if options.json:
        save(options.json, rows)
    lacking = sum(bool(row.missing) for row in rows)
    emit(f'{len(rows)} fronts in {(time.monotonic() - start_s) / 60:.1f} minutes: {len(failed)} '
         f'below their floors or failed, {lacking} not run for lack of data or network.')
    if options.write_floors:
        if given != seeds:
            # Other scenes: the floors do not apply to them.
            floors = {}
        write_floors(FLOORS, given, renewed(floors, rows, commit(), options.reason))
    if failed:
        emit('Below their floors: ' + '; '.join(failed))
    return int(bool(failed))


if __name__ == '__main__':
    sys.exit(main())
