# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""One bag of many, as a function that any worker of a pool or a cluster can call."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from plane_detector.stopping import Stopped
from plane_detector.threads import one_thread
from plane_detector.tools.replay.options import ReplayOptions
from plane_detector.tools.replay.part_folder import FINISHED, STATE, replay_fields
from plane_detector.tools.replay.run import replay

STOP_FILE = 'stop'
DONE_BEFORE, FAILED, INTERRUPTED = 'done before', 'failed', 'interrupted'


@dataclass(frozen=True)
class BagSummary:
    """
    Result of a bag.

    Attributes
    ----------
    bag : str
        Name of the new bag.
    state : str
        ``finished``, ``done before``, ``failed`` or ``interrupted``.
    frames, planes, skipped, damaged : int
        As in :class:`Tally`.
    seconds : float
        Wall time.
    depth : str
        The depth that was used and why.
    error : str
        Empty if there was none.

    """

    bag: str
    state: str
    frames: int = 0
    planes: int = 0
    skipped: int = 0
    damaged: int = 0
    seconds: float = 0.0
    depth: str = ''
    error: str = ''


def replay_bag(options: ReplayOptions, run_folder: Path) -> BagSummary:
    """
    Replay a bag on one thread, unless it is finished already; never raises.

    Parameters
    ----------
    options : ReplayOptions
    run_folder : Path
        Shared by all workers and the main process: the summary is written there as a JSON file,
        and a file named ``stop`` there ends the work.

    """
    summary = _done_before(options)
    if summary is None:
        start_s = time.monotonic()
        with one_thread():
            summary = _replayed(options, run_folder / STOP_FILE)
        summary = BagSummary(**{**asdict(summary), 'seconds': time.monotonic() - start_s})
    write_summary(summary, run_folder)
    return summary


def write_summary(summary: BagSummary, run_folder: Path) -> None:
    """Write a summary for the main process."""
    path = run_folder / f'{summary.bag}.json'
    draft = path.with_suffix('.draft')
    draft.write_text(json.dumps(asdict(summary)), encoding='utf-8')
    draft.rename(path)


def read_summary(bag: str, run_folder: Path) -> BagSummary | None:
    """Return the summary written by a worker, or None."""
    try:
        return BagSummary(**json.loads((run_folder / f'{bag}.json').read_text(encoding='utf-8')))
    except FileNotFoundError:
        return None


def _done_before(options: ReplayOptions) -> BagSummary | None:
    name, fields = options.target.name, replay_fields(options.target)
    if fields.get(STATE) != FINISHED:
        return None
    made = (fields['replay.source'], fields['replay.options'])
    if made != (options.source.name, options.fingerprint):
        return BagSummary(name, FAILED, error=(
            f'{options.target} was made from {made[0]} with other options: remove it, or choose '
            'another folder'))
    return BagSummary(name, DONE_BEFORE, *(int(fields[f'replay.{key}']) for key in (
        'frames', 'planes', 'skipped', 'damaged')), depth=fields['replay.depth'])


def _replayed(options: ReplayOptions, stop: Path) -> BagSummary:
    name = options.target.name
    try:
        if stop.exists():
            raise Stopped
        tally = replay(options, stop.exists, quiet=True)
    except Stopped:
        return BagSummary(name, INTERRUPTED)
    except (OSError, ValueError, ModuleNotFoundError) as error:
        return BagSummary(name, FAILED, error=str(error))
    except Exception as error:  # one bag must not end the others
        return BagSummary(name, FAILED, error=f'{type(error).__name__}: {error}')
    state = FAILED if tally.failure else tally.state
    return BagSummary(name, state, tally.processed, tally.planes, tally.skipped, tally.damaged,
                      depth=tally.depth, error=tally.failure)
