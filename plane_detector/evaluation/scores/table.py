# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Parts of the table of scores: measurements, their jobs, the resulting rows, floors.

A measurement is a function of a draw. A draw is a seed of the scene and its noise, or of RANSAC
for given images, so the spread over the draws shows how much a value changes if nothing is better
or worse.
"""

from __future__ import annotations

import csv
import datetime
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from plane_detector.evaluation.benchmark.report import HELD_OUT

HIGHER, LOWER = 1, -1
"""Which values of a front are better."""
Values = Mapping[str, float | Sequence[float]]
"""By the name of the front; several values are, for example, those of several images."""


@dataclass(frozen=True)
class Draw:
    """The input of a measurement."""

    seed: int
    part: str | int  # of the images or scenes that it is about
    data: Path  # folder of real images
    cases: Path  # folder of situations as programs


@dataclass(frozen=True)
class Measurement:
    """A function that measures one or several fronts, and on what it is run."""

    group: str
    function: Callable[[Draw], Values]
    fronts: Mapping[str, int]  # HIGHER or LOWER by the name
    draws: int = 1
    # Each is a job of its own. With several, a front may come from some of them only.
    parts: Sequence[str | int] = ('',)
    needs: tuple[str, ...] = ()  # of NEEDS
    # Fronts whose deviation over the draws, image by image, is a front of its own.
    steady: tuple[str, ...] = ()
    # Least spread as a share of the value, for effects of the machine.
    least_share: float = 0.0

    @property
    def all_fronts(self) -> dict[str, int]:
        """All fronts, with the deviations over the draws."""
        return {**self.fronts, **{f'{name}, deviation by seed': LOWER for name in self.steady}}


@dataclass(frozen=True)
class Job:
    """One run of a measurement."""

    measurement: int  # index into the table
    function: Callable[[Draw], Values]
    draw: Draw


@dataclass(frozen=True)
class Done:
    """The result of a job."""

    measurement: int
    seed: int
    values: Mapping[str, list[float]]
    error: str  # empty if it ran


def run_job(job: Job) -> Done:
    """Run a job; an error becomes its text, so that the rest of the table is measured."""
    values, error = {}, ''
    try:
        values = {name: np.atleast_1d(np.asarray(value, float)).tolist()
                  for name, value in job.function(job.draw).items()}
    except Exception as problem:  # whatever it is belongs in the table
        error = f'{type(problem).__name__}: {problem}'.splitlines()[0]
    return Done(job.measurement, job.draw.seed, values, error)


@dataclass(frozen=True)
class Row:
    """A front as it was measured."""

    group: str
    name: str
    better: int
    # of each draw, its values in the same order; empty if it was not run
    draws: Mapping[int, list[float]] = field(default_factory=dict)
    missing: str = ''  # missing requirement, because of which it was not run
    error: str = ''  # why it failed
    least_share: float = 0.0

    @property
    def known(self) -> np.ndarray:
        """All finite values."""
        values = np.array([value for draw in self.draws.values() for value in draw])
        return values[np.isfinite(values)]

    @property
    def value(self) -> float:
        """The mean; NaN if there is none."""
        return float(self.known.mean()) if self.known.size else float('nan')

    @property
    def worst(self) -> float:
        """The worst value."""
        return float(self.better * (self.better * self.known).min())

    @property
    def spread(self) -> float:
        """
        Two standard errors of the value: over the draws, or over the values of a single draw.

        In 8 % of the cases, one of two equally good versions is below the other by more than this.
        Where the draws hardly differ, it is at least the effect of two deviations in one of the
        values.
        """
        means = [np.mean(known) for draw in self.draws.values()
                 if (known := [value for value in draw if np.isfinite(value)])]
        samples = means if len(means) > 1 else self.known
        error = float(np.std(samples, ddof=1) / np.sqrt(len(samples))) if len(samples) > 1 else 0.0
        one = [2 * np.std(known) / len(known) for draw in self.draws.values()
               if (known := [value for value in draw if np.isfinite(value)])]
        return max(2 * error, float(np.mean(one)), self.least_share * abs(self.value))


def deviation(row: Row) -> Row:
    """Return a front for the change of each value of a row between draws."""
    name = f'{row.name}, deviation by seed'
    lengths = {len(draw) for draw in row.draws.values()}
    if len(lengths) != 1 or len(row.draws) < 2:
        return Row(row.group, name, LOWER, {}, row.missing, row.error)
    values = np.array(list(row.draws.values()))
    values = values[:, np.isfinite(values).all(axis=0)]
    # One draw of all: its spread is over the images.
    return Row(row.group, name, LOWER, {0: values.std(axis=0, ddof=1).tolist()}, row.missing,
               row.error)


def rows_of(table: Sequence[Measurement], done: Iterable[Done],
            missing: Mapping[str, str]) -> list[Row]:
    """Return the rows of all measurements; ``missing`` says why a need is not met."""
    draws: dict[tuple[int, str], dict[int, list[float]]] = {}
    errors: dict[int, str] = {}
    for one in done:
        if one.error:
            errors[one.measurement] = one.error
        for name, values in one.values.items():
            draws.setdefault((one.measurement, name), {}).setdefault(one.seed, []).extend(values)
    rows = []
    for k, measurement in enumerate(table):
        lacks = '; '.join(missing[need] for need in measurement.needs if need in missing)
        for name, better in measurement.fronts.items():
            own = draws.pop((k, name), {})
            error = errors.get(k, '' if own or lacks else 'gave no value')
            row = Row(measurement.group, name, better, own, lacks, error, measurement.least_share)
            rows += [row, *([deviation(row)] if name in measurement.steady else [])]
    if draws:
        raise ValueError(f'not in the table: {", ".join(name for _, name in draws)}')
    return rows


@dataclass(frozen=True)
class Floor:
    """The value below which a front must not fall by more than the spread; for LOWER, above."""

    value: float
    spread: float
    commit: str
    reason: str = ''  # why it was lowered, and what was gained

    def holds(self, row: Row) -> bool:
        """Tell whether a row is not worse than the floor by more than the spread."""
        lost = row.better * (self.value - row.value)
        return bool(lost <= self.spread + rounding(self.value))

    def is_exceeded(self, row: Row) -> bool:
        """Tell whether a row is better than the floor by more than the spread."""
        return bool(row.better * (row.value - self.value) > self.spread + rounding(self.value))


_DIGITS = 4
_FIELDS = ('front', 'floor', 'spread', 'commit', 'reason')
_SEEDS = 'seeds from'


def rounding(value: float) -> float:
    """Return the rounding error of a floor as written."""
    return abs(value) * 10.0 ** (1 - _DIGITS) + 1e-9


def read_floors(path: Path) -> tuple[str, dict[str, Floor]]:
    """Return the date or number of the seeds, and the floors by the name of the front."""
    with path.open(encoding='utf-8', newline='') as file:
        rows = {row['front']: row for row in csv.DictReader(file)}
    seeds = rows.pop(_SEEDS)['floor']
    return seeds, {name: Floor(float(row['floor']), float(row['spread']), row['commit'],
                               row['reason']) for name, row in rows.items()}


def write_floors(path: Path, seeds: str, floors: Mapping[str, Floor]) -> None:
    """Write them."""
    with path.open('w', encoding='utf-8', newline='') as file:
        writer = csv.writer(file, lineterminator='\n')
        writer.writerow(_FIELDS)
        writer.writerow((_SEEDS, seeds, '', '', ''))
        writer.writerows((name, f'{floor.value:.{_DIGITS}g}', f'{floor.spread:.2g}', floor.commit,
                          floor.reason) for name, floor in floors.items())


def renewed(floors: Mapping[str, Floor], rows: Iterable[Row], commit: str,
            reason: str) -> dict[str, Floor]:
    """
    Return the floors after a change.

    A floor rises to a value that is better by more than its spread. It falls to a value that is
    lower by more than the spread only for a stated reason; without one it stays. A new front gets
    its value.
    """
    result = dict(floors)
    for row in rows:
        if not row.known.size or row.error:
            continue
        floor, now = floors.get(row.name), Floor(row.value, row.spread, commit)
        if floor is None or floor.is_exceeded(row):
            result[row.name] = now
        elif not floor.holds(row) and reason:
            result[row.name] = Floor(row.value, row.spread, commit, reason)
    return result


def first_seed(text: str) -> int:
    """
    Return the first seed of a date such as 2026-11-27, or of a number, never below HELD_OUT.

    Each day has a hundred seeds of its own, for 27 years.
    """
    seed = int(text) if text.isdigit() else HELD_OUT + 100 * (
        datetime.date.fromisoformat(text).toordinal() % 10000)
    if seed < HELD_OUT:
        raise ValueError(f'{text}: seeds below {HELD_OUT} are for tuning')
    return seed
