# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The folder of a new bag until it is complete: OUTPUT.part, used by one process, then renamed.

    OUTPUT.part/lock      held while a process writes there; released if the process dies
    OUTPUT.part/OUTPUT    the bag being written
    OUTPUT.part/before    the bag of an earlier run, while a resumed run copies it
"""

from __future__ import annotations

import fcntl
import os
import shutil
from pathlib import Path

import yaml

from plane_detector.tools.replay.bag_salvage import salvage

FINISHED = 'finished'
STATE = 'replay.state'


def replay_fields(bag: Path) -> dict[str, str]:
    """Return the fields that a replay wrote into the metadata of its bag; empty for other bags."""
    try:
        with open(bag / 'metadata.yaml', encoding='utf-8') as file:
            found = yaml.safe_load(file)['rosbag2_bagfile_information']['custom_data']
    except (OSError, yaml.YAMLError, KeyError, TypeError):
        return {}
    return found if isinstance(found, dict) and STATE in found else {}


class PartFolder:
    """
    Folder of a bag that is being written; a context manager.

    Parameters
    ----------
    target : Path
        Final path of the bag.
    leftover : str
        See :class:`ReplayOptions`.

    Attributes
    ----------
    bag : Path
        Path to write it to.
    before : Path or None
        An unfinished bag of an earlier run, which this run continues.

    Raises
    ------
    FileExistsError
        The target exists, or there is an unfinished bag that must not be changed.
    BlockingIOError
        Another process is writing this bag.

    """

    def __init__(self, target: Path, leftover: str = 'refuse'):
        self._target, self._leftover = target, leftover
        self._folder = target.with_name(f'{target.name}.part')
        self._before = self._folder / 'before'
        self.bag = self._folder / target.name
        self.before: Path | None = None

    def __enter__(self) -> PartFolder:
        self._check_target()
        self._folder.mkdir(parents=True, exist_ok=True)
        self._lock = open(self._folder / 'lock', 'w', encoding='ascii')
        try:
            self._hold()
            self._clear()
        except BaseException:
            self._lock.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Remove what is no longer needed."""
        self._lock.close()
        if not self.bag.exists() and not self._before.exists():
            shutil.rmtree(self._folder, ignore_errors=True)

    def finish(self) -> None:
        """Rename the bag, which is closed now, to its final path."""
        if os.path.lexists(self._target):  # an unfinished bag: _check_target
            shutil.rmtree(self._target)
        self.bag.rename(self._target)
        shutil.rmtree(self._before, ignore_errors=True)

    def discard(self) -> None:
        """Remove the bag."""
        shutil.rmtree(self.bag)

    def _check_target(self) -> None:
        target = self._target
        if not os.path.lexists(target):
            return
        unfinished = replay_fields(target).get(STATE, FINISHED) != FINISHED
        if not unfinished:
            raise FileExistsError(f'{target} already exists: choose another name')
        if self._leftover == 'refuse':
            raise FileExistsError(f'{target} already exists, not finished: --resume continues '
                                  'it, or choose another name')

    def _hold(self) -> None:
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise BlockingIOError(f'{self._target} is being written by another process'
                                  ) from error

    def _clear(self) -> None:
        """Remove the unfinished bag of an earlier run, or prepare it for resuming."""
        left = [path for path in (self._before, self.bag) if path.exists()]
        if left and self._leftover == 'refuse':
            raise FileExistsError(f'{self._folder} contains the bag of a killed run: '
                                  '--resume continues it, or remove it')
        if self._leftover == 'resume':
            self.before = self._laid_ready()
        else:
            shutil.rmtree(self._before, ignore_errors=True)
        shutil.rmtree(self.bag, ignore_errors=True)

    def _laid_ready(self) -> Path | None:
        if not self._before.exists():
            if self.bag.exists() and salvage(self.bag):
                self.bag.rename(self._before)
            elif os.path.lexists(self._target):
                self._target.rename(self._before)
        return self._before if self._before.exists() and salvage(self._before) else None
