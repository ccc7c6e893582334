# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Many bags, each a joblib job: processes on this machine, or the configured backend.

As with make, a second run does only what is missing: a new bag gets its name when complete.
"""

from __future__ import annotations

import csv
import glob
import os
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import joblib

from plane_detector._runtime.process import one_thread
from plane_detector.tools.replay.bag_reader import FILE_SUFFIXES, BagError, bag_name
from plane_detector.tools.replay.options import ReplayOptions
from plane_detector.tools.replay.replay_bag import replay
from plane_detector.tools.replay.writer import AtomicOutput, part_folder, replay_fields

SUMMARY_NAME = 'summary.csv'
FINISHED, DONE_BEFORE, FAILED = 'finished', 'done before', 'failed'
_COUNTS = ('frames', 'planes', 'skipped', 'damaged', 'unpaired')
_SHOWN_ERROR = 60


@dataclass(frozen=True)
class BagSummary:
    """Result of a bag: name of the new bag, and ``finished``, ``done before`` or ``failed``."""

    bag: str
    state: str
    frames: int = 0
    planes: int = 0
    skipped: int = 0
    damaged: int = 0
    unpaired: int = 0
    seconds: float = 0.0
    depth: str = ''
    error: str = ''


def is_collection(text: str) -> bool:
    """Whether a path is a pattern, or a folder of bags that is not a bag itself."""
    if not os.path.lexists(text):
        return glob.has_magic(text)
    path = Path(text)
    return path.is_dir() and not _is_bag(path) and any(_below(path, None))


def find_bags(inputs: Sequence[str], left_out: Path | None = None) -> dict[str, Path]:
    """
    Return the bags to process, by the names of the new bags, in a fixed order.

    The inputs are bags, patterns, and folders, which are searched recursively (except
    ``left_out``, the folder of the new bags). A bag given directly keeps its name; a bag found in
    a folder is named by its path in the folder: ``monday_walk`` for ``monday/walk``.

    Raises
    ------
    FileNotFoundError
        A path does not exist, or a folder contains no bag.
    BagError
        Two new bags would have the same name.

    """
    named: dict[str, Path] = {}
    for text in inputs:
        found = list(_of_input(text, left_out))
        if not found:
            raise FileNotFoundError(f'there is no bag {"in" if Path(text).is_dir() else "at"} '
                                    f'{text}')
        for name, path in found:
            if named.setdefault(name, path).resolve() != path.resolve():
                raise BagError(f'{named[name]} and {path} would both become {name}: process them '
                               'in two runs, with two folders')
    return named


def _of_input(text: str, left_out: Path | None) -> Iterator[tuple[str, Path]]:
    """Yield names and paths of the bags that an input stands for."""
    paths = [Path(text)] if os.path.lexists(text) else [
        path for path in map(Path, sorted(glob.glob(text, recursive=True)))
        if path.is_dir() or _is_bag(path)]
    for path in paths:
        if path.is_dir() and not _is_bag(path):
            yield from (('_'.join((*bag.relative_to(path).parts[:-1], bag_name(bag))), bag)
                        for bag in _below(path, left_out))
        else:
            yield bag_name(path), path


def _below(folder: Path, left_out: Path | None) -> Iterator[Path]:
    """Yield the bags in a folder and its subfolders, sorted by name, except hidden ones."""
    for path in sorted(folder.iterdir()):
        if _is_bag(path):
            yield path
        elif path.is_dir() and not path.name.startswith('.') and path.resolve() != left_out:
            yield from _below(path, left_out)


def _is_bag(path: Path) -> bool:
    """Whether a path is a bag file, or a bag folder: with metadata, or of a killed recording."""
    if not path.is_dir():
        return path.suffix in FILE_SUFFIXES
    entries = list(path.iterdir())
    storages = [entry for entry in entries if entry.suffix in ('.mcap', '.db3')]
    return path / 'metadata.yaml' in entries or len(storages) == 1 and not any(
        entry.is_dir() or entry.suffix == '.bag' for entry in entries)


def replay_many(bags: Mapping[str, Path], options: ReplayOptions, jobs: int = -1
                ) -> list[BagSummary]:
    """
    Replay bags; return the summary of each, in order, and write them as a table.

    They run in processes on this machine, or where a surrounding ``joblib.parallel_config`` says.

    Parameters
    ----------
    bags : mapping of str to Path
        By the names of the new bags.
    options : ReplayOptions
        For all bags: the target is the folder of the new bags; figures, ply, table and map are
        folders with one entry per bag.
    jobs : int
        Bags at a time; -1: as many as the backend has cores.

    Raises
    ------
    OSError
        The folder cannot be written, a cluster does not answer, or a worker was killed.

    """
    options.target.mkdir(parents=True, exist_ok=True)
    each = [_options_of(name, source, options) for name, source in bags.items()]
    try:
        summaries = joblib.Parallel(n_jobs=jobs, batch_size=1, verbose=11)(
            joblib.delayed(replay_one)(one) for one in each)
    except OSError:  # a cluster does not answer
        raise
    except Exception as error:  # each backend has its own class for a worker that died
        begun = [one.target.name for one in each if part_folder(one.target).exists()]
        raise OSError(
            f'a worker ended, at one of {", ".join(begun) or "the bags"}: {type(error).__name__}: '
            f'{" ".join(str(error).split())}. Complete bags are kept; the same command processes '
            'the others') from error
    with AtomicOutput(options.target / SUMMARY_NAME) as draft:
        with open(draft.path, 'w', newline='', encoding='utf-8') as file:
            writer = csv.DictWriter(file, [field.name for field in fields(BagSummary)])
            writer.writeheader()
            writer.writerows({**asdict(one), 'seconds': f'{one.seconds:.3f}'} for one in summaries)
        draft.publish()
    return summaries


def _options_of(name: str, source: Path, options: ReplayOptions) -> ReplayOptions:
    """Return the options of a bag: one thread, and its paths in the folders of the results."""
    config = options.config
    if not config.depth.threads:
        config = replace(config, depth=replace(config.depth, threads=1))

    def place(folder: Path | None, entry: str) -> Path | None:
        return None if folder is None else folder.absolute() / entry

    return replace(options, source=source.absolute(), config=config,
                   target=place(options.target, name), figures=place(options.figures, name),
                   ply=place(options.ply, name), table=place(options.table, f'{name}.csv'),
                   map_file=place(options.map_file, f'{name}.json'))


def replay_one(options: ReplayOptions) -> BagSummary:
    """Replay a bag on one thread, unless it exists; a failure does not end the other bags."""
    start_s, name = time.monotonic(), options.target.name
    try:
        if os.path.lexists(options.target):
            return _done_before(options)
        with one_thread():
            tally = replay(options, quiet=True)
    except Exception as error:
        kind = '' if isinstance(error, (OSError, ValueError)) else f'{type(error).__name__}: '
        return BagSummary(name, FAILED, error=f'{kind}{error}')
    return BagSummary(name, FINISHED, tally.processed, tally.planes, tally.skipped, tally.damaged,
                      tally.unpaired, time.monotonic() - start_s, tally.depth,
                      '; '.join(tally.losses()))


def _done_before(options: ReplayOptions) -> BagSummary:
    """Return the summary in the metadata of a new bag; any version may have written it."""
    found = replay_fields(options.target)
    if (found.get('replay.source'), found.get('replay.options')) != (
            options.source.name, options.fingerprint):
        raise BagError(f'{options.target} was made from {found.get("replay.source", "elsewhere")} '
                       'with other options: remove it, or choose another folder')
    wanted = filter(None, (options.figures, options.ply, options.table, options.map_file))
    if missing := [str(path) for path in wanted if not path.exists()]:
        raise BagError(f'{options.target} was made before, without {", ".join(missing)}: remove '
                       'it to make it again with them, or choose another folder')
    return BagSummary(options.target.name, DONE_BEFORE, *(
        int(found.get(f'replay.{key}', 0)) for key in _COUNTS),
        depth=found.get('replay.depth', ''))


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
    return '\n'.join([*lines, f'{len(summaries)} bag{"s" if len(summaries) > 1 else ""}, '
                      f'{sum(one.frames for one in summaries)} frames: '
                      + ', '.join(f'{count} {state}' for state, count in states.items())])
