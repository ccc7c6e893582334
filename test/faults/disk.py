# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A replay that fills the disk; one that is stopped or killed is in test_replay_faults.py."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
from bags import write_bag
from common import ROOT, Row
from replay_helpers import CAMERA, camera_messages

from plane_detector.evaluation.scenes.rooms import random_room

SCENES, REPEATS = 4, 60
FULL_BYTES = 20_000_000


def replays(folder: Path) -> list[Row]:
    """Return what is left of a replay to each storage where no file grows beyond some bytes."""
    scenes = [random_room(np.random.default_rng(seed), CAMERA) for seed in range(SCENES)]
    bag, target = write_bag(folder / 'walk', camera_messages(scenes * REPEATS)), folder / 'full'

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (FULL_BYTES, FULL_BYTES))

    rows = []
    for storage in ('mcap', 'sqlite3'):
        done = subprocess.run(
            [sys.executable, '-m', 'plane_detector.tools.replay', str(bag), str(target),
             '--storage', storage], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, preexec_fn=limit, check=False)
        rows.append(Row(
            f'replay to {storage}, disk full after {FULL_BYTES // 10**6} MB',
            'exit code 1, one line, nothing is left',
            f'exit code {done.returncode}, {done.stdout.splitlines()[-1][:60]}',
            done.returncode == 1 and 'cannot be written' in done.stdout
            and not list(folder.glob('*full*')) and 'Traceback' not in done.stdout))
    return rows
