# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Many bags, each a separate job on a pool of workers.

The result of a job is in its files, not in its return value: the new bag, which is renamed when it
is complete, and a summary in the folder of the run. If a worker dies, the bags that it had begun
are therefore restarted; a bag on which a worker dies while it is alone is the cause, and fails.
"""

from __future__ import annotations

import csv
import os
import shutil
import signal
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from tempfile import mkdtemp

from joblib import Parallel, delayed
from tqdm import tqdm

from plane_detector.stopping import Background
from plane_detector.tools.replay.backends import kill_processes, use_backend
from plane_detector.tools.replay.one_bag import (
    FAILED,
    INTERRUPTED,
    STOP_FILE,
    BagSummary,
    read_summary,
    replay_bag,
    write_summary,
)
from plane_detector.tools.replay.options import ReplayOptions
from plane_detector.tools.replay.signals import ShouldStop

SUMMARY_NAME = 'summary.csv'
_LOOK_S = 0.2
# derived: workers abandon a frame after 1.5 s and close their bags; all have ended within 3 s.
_PATIENCE_S = 2.5
# A bag may have been next to the one that ended its worker: it is tried twice, then alone.
_TRIES_BESIDE_OTHERS = 2
_SHOWN_ERROR = 60


@dataclass(frozen=True)
class Pool:
    """Where the jobs run: see :func:`use_backend`."""

    backend: str = 'processes'
    jobs: int = -1
    scheduler: str = ''


def make_jobs(bags: dict[str, Path], folder: Path, options: ReplayOptions) -> list[ReplayOptions]:
    """Return the options of each bag: one thread, its paths in the result folders."""
    config = options.config
    if not config.depth.threads:
        config = replace(config, depth=replace(config.depth, threads=1))

    def place(base: Path | None, name: str) -> Path | None:
        return None if base is None else base / name

    return [replace(options, source=source.absolute(), target=folder.absolute() / name,
                    config=config, figures=place(options.figures, name),
                    ply=place(options.ply, name), table=place(options.table, f'{name}.csv'),
                    leftover='resume' if options.leftover == 'resume' else 'restart')
            for name, source in bags.items()]


def replay_many(jobs: Sequence[ReplayOptions], folder: Path, pool: Pool,
                should_stop: ShouldStop) -> list[BagSummary]:
    """
    Replay bags; return the summary of each, in order, and write them as a table.

    Raises
    ------
    OSError
        The folder cannot be written, or the cluster does not answer.
    ModuleNotFoundError, ValueError
        The backend cannot be used; see :func:`use_backend`.

    """
    with _run_folder(folder) as run_folder:
        work = Background(lambda: _work(jobs, run_folder, pool), 'replay_many')
        _watch(work, jobs, run_folder, should_stop)
        if work.wait(0):
            work.result()
        summaries = [read_summary(job.target.name, run_folder)
                     or BagSummary(job.target.name, INTERRUPTED) for job in jobs]
    _write_table(summaries, folder / SUMMARY_NAME)
    return summaries


def describe(summaries: Sequence[BagSummary]) -> str:
    """Return the summaries as a readable table."""
    width = max(len('bag'), *(len(one.bag) for one in summaries))
    lines = [f'{"bag":<{width}}  {"state":<11} {"frames":>7} {"planes":>8} {"skipped":>7} '
             f'{"damaged":>7} {"seconds":>8}  error']
    for one in summaries:
        error = one.error if len(one.error) <= _SHOWN_ERROR else one.error[:_SHOWN_ERROR] + '...'
        lines.append(f'{one.bag:<{width}}  {one.state:<11} {one.frames:7d} {one.planes:8d} '
                     f'{one.skipped:7d} {one.damaged:7d} {one.seconds:8.1f}  {error}'.rstrip())
    states = Counter(one.state for one in summaries)
    count_of_bags = f'{len(summaries)} bag{"s" if len(summaries) > 1 else ""}'
    lines.append(f'{count_of_bags}, {sum(one.frames for one in summaries)} frames: '
                 + ', '.join(f'{count} {state}' for state, count in states.items()))
    return '\n'.join(lines)


@contextmanager
def _run_folder(folder: Path):
    folder.mkdir(parents=True, exist_ok=True)
    run_folder = Path(mkdtemp(prefix='.replay-', dir=folder.absolute()))
    run_folder.chmod(0o777)  # workers of a cluster may run as other users
    try:
        yield run_folder
    finally:
        shutil.rmtree(run_folder, ignore_errors=True)


def _watch(work: Background, jobs: Sequence[ReplayOptions], run_folder: Path,
           should_stop: ShouldStop) -> None:
    """Show the progress; after a signal let the workers end, and abandon those that do not."""
    deadline_s = float('inf')
    with tqdm(total=len(jobs), unit='bag', disable=None) as progress:
        while not work.wait(_LOOK_S) and time.monotonic() < deadline_s:
            _show(progress, run_folder)
            if should_stop() and deadline_s == float('inf'):
                (run_folder / STOP_FILE).touch()
                deadline_s = time.monotonic() + _PATIENCE_S
        _show(progress, run_folder)
    if not work.wait(0):
        kill_processes()


def _show(progress: tqdm, run_folder: Path) -> None:
    """Show how many bags and frames are done."""
    done = [read_summary(path.stem, run_folder) for path in run_folder.glob('*.json')]
    progress.n = len(done)
    progress.set_postfix_str(f'{sum(one.frames for one in done)} frames')


def _work(jobs: Sequence[ReplayOptions], run_folder: Path, pool: Pool) -> None:
    """Run all jobs; repeat those whose worker died, up to the limits."""
    # Ctrl-C is sent to all processes of the terminal; the stop file informs the workers.
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    tries: Counter[str] = Counter()
    waiting = list(jobs)
    with use_backend(pool.backend, pool.jobs, pool.scheduler) as ahead:
        while waiting and not (run_folder / STOP_FILE).exists():
            alone = [job for job in waiting if tries[job.target.name] >= _TRIES_BESIDE_OTHERS]
            batch = alone[:1] or waiting
            error = _one_round(batch, run_folder, ahead)
            waiting = [job for job in waiting if not read_summary(job.target.name, run_folder)]
            _count_tries([job for job in batch if job in waiting], bool(alone), tries, error,
                         run_folder)
            waiting = [job for job in waiting if not read_summary(job.target.name, run_folder)]


def _one_round(jobs: Sequence[ReplayOptions], run_folder: Path, ahead: int | str) -> str:
    """Return why the pool broke; empty if all jobs have ended."""
    try:
        summaries = Parallel(batch_size=1, pre_dispatch=ahead)(
            delayed(replay_bag)(job, run_folder) for job in jobs)
    except Exception as error:  # each backend has its own class for a worker that died
        return f'{type(error).__name__}: {" ".join(str(error).split())}'
    for summary in summaries:  # if the cluster does not share the folder of the run
        write_summary(summary, run_folder)
    return ''


def _count_tries(lost: Sequence[ReplayOptions], was_alone: bool, tries: Counter[str], error: str,
                 run_folder: Path) -> None:
    """Count a try for the bags that were begun; one that was tried alone has failed."""
    begun = [job for job in lost if os.path.lexists(f'{job.target}.part')] or list(lost)
    for job in begun:
        tries[job.target.name] += 1
        if was_alone:
            write_summary(BagSummary(job.target.name, FAILED,
                                     error=f'its worker ended: {error}'), run_folder)


def _write_table(summaries: Sequence[BagSummary], path: Path) -> None:
    with open(path, 'w', newline='', encoding='utf-8') as file:
        writer = csv.DictWriter(file, [field.name for field in fields(BagSummary)])
        writer.writeheader()
        writer.writerows({**asdict(one), 'seconds': f'{one.seconds:.3f}'} for one in summaries)
