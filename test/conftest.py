# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Scenes that several tests look at, rendered once, and the real pictures where they are."""

import os
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from plane_detector.tools.scenes import random_room

REPOSITORY = Path(__file__).resolve().parents[1]


@lru_cache(maxsize=16)
def cached_room(seed):
    return random_room(np.random.default_rng(seed))


@pytest.fixture
def room():
    """Return a function: seed -> random room at 640 x 480."""
    return cached_room


@pytest.fixture
def data_folder():
    """Return the folder of real pictures; the test is skipped where there is none."""
    folder = Path(os.environ.get('PLANE_DETECTOR_DATA', REPOSITORY.parent / 'shared' / 'data'))
    if not folder.is_dir():
        pytest.skip(f'no real pictures in {folder}; PLANE_DETECTOR_DATA may name their folder')
    return folder
