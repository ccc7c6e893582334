# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A replay that is killed, is stopped, or fills the disk."""

from __future__ import annotations

import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from bags import read_bag, write_bag
from common import MOST_ENDING_S, ROOT, Row
from replay_helpers import CAMERA, camera_messages

from plane_detector.evaluation.scenes.rooms import random_room

COMMAND = [sys.executable, '-m', 'plane_detector.tools.replay']
PLANES = '/plane_detector/planes'
SCENES, REPEATS = 4, 60
FULL_BYTES = 20_000_000


def replays(folder: Path) -> list[Row]:
    """Return what is left of replays that end early, for both storages."""
    scenes = [random_room(np.random.default_rng(seed), CAMERA) for seed in range(SCENES)]
    bag = write_bag(folder / 'walk', camera_messages(scenes * REPEATS))
    frames, rows = SCENES * REPEATS, []
    for storage in ('mcap', 'sqlite3'):
        rows.append(_stopped(bag, folder / 'stopped', storage))
        rows.append(_killed(bag, folder / 'killed', storage, frames))
        rows.append(_full(bag, folder / 'full', storage))
    return rows


def _begun(bag: Path, target: Path, *options: str, **process: object) -> subprocess.Popen:
    return subprocess.Popen([*COMMAND, str(bag), str(target), *options], cwd=ROOT,
                            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **process)


def _wait_until_it_writes(target: Path) -> None:
    """Wait until the bag, under its final or its temporary name, holds something."""
    end_s = time.monotonic() + 60
    while time.monotonic() < end_s:
        files = [path for path in target.parent.rglob('*') if path.is_file()
                 and target.name in str(path) and path.suffix in ('.mcap', '.db3')]
        if sum(path.stat().st_size for path in files) > 200_000:
            return
        time.sleep(0.02)


def _stopped(bag: Path, target: Path, storage: str) -> Row:
    _remove(target)
    process = _begun(bag, target, '--storage', storage)
    _wait_until_it_writes(target)
    start_s = time.monotonic()
    process.send_signal(signal.SIGTERM)
    text, _ = process.communicate(timeout=60)
    seconds = time.monotonic() - start_s
    planes = _planes(target.with_name(f'interrupted_{target.name}'))
    return Row(f'replay to {storage}, SIGTERM',
               'ends within 3 s, the bag of the frames so far is whole',
               f'{seconds:.2f} s, exit code {process.returncode}, {planes} frames readable',
               seconds <= MOST_ENDING_S and process.returncode == 130 and planes > 0
               and not target.exists() and 'Traceback' not in text)


def _killed(bag: Path, target: Path, storage: str, frames: int) -> Row:
    _remove(target)
    process = _begun(bag, target, '--storage', storage)
    _wait_until_it_writes(target)
    process.kill()
    process.communicate()
    was_there = target.exists()
    again = _begun(bag, target, '--storage', storage)
    text, _ = again.communicate(timeout=300)
    planes = _planes(target)
    return Row(f'replay to {storage}, SIGKILL, then again',
               f'nothing under its name, then all {frames} frames',
               f'exit code {again.returncode}, {planes} frames',
               not was_there and again.returncode == 0 and planes == frames
               and 'Traceback' not in text)


def _full(bag: Path, target: Path, storage: str) -> Row:
    """Let no file grow beyond some bytes, which is a full disk to the program."""
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (FULL_BYTES, FULL_BYTES))

    _remove(target)
    process = _begun(bag, target, '--storage', storage, preexec_fn=limit)
    text, _ = process.communicate(timeout=300)
    return Row(f'replay to {storage}, disk full after {FULL_BYTES // 10**6} MB',
               'exit code 1, one line, nothing is left',
               f'exit code {process.returncode}, {text.splitlines()[-1][:60]}',
               process.returncode == 1 and 'cannot be written' in text
               and not list(target.parent.glob(f'*{target.name}*')) and 'Traceback' not in text)


def _planes(target: Path) -> int:
    """Return how many frames of planes a bag holds; -1 where it cannot be opened."""
    try:
        return len(read_bag(target)[PLANES])
    except Exception:  # whatever a damaged bag provokes in the library: it is not readable
        return -1


def _remove(target: Path) -> None:
    for path in target.parent.glob(f'*{target.name}*'):
        shutil.rmtree(path) if path.is_dir() else path.unlink()
