# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tables and a contact sheet on rendered lived-in rooms with exact ground truth."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from plane_detector.drawing import colour_depth, overlay
from plane_detector.evaluation.benchmark.rooms import SIGMAS, noisy_depth, report_sets
from plane_detector.evaluation.benchmark.tables import emit, grey_of, write_sheet
from plane_detector.evaluation.peers import Method, Ours
from plane_detector.evaluation.scenes.living_rooms import living_room
from plane_detector.evaluation.scenes.rooms import Scene

SHEET_ROOMS = 6
"""Rooms of the contact sheet, the first of the tuning seeds."""
_PANEL_WIDTH_PX = 320


@lru_cache(maxsize=64)
def furnished(seed: int) -> Scene:
    """Return one living room."""
    return living_room(np.random.default_rng(seed))


def report_living(methods: Sequence[Method], count: int, slow_count: int, output: Path) -> None:
    """Print the tables of the living rooms and write a contact sheet of the first rooms."""
    report_sets('Rendered living rooms', furnished, methods, count, slow_count)
    emit('What is curved belongs to no plane, and its pixels count as that.',
         f'Contact sheet: `{draw_rooms(range(min(count, SHEET_ROOMS)), output)}`')


def draw_rooms(seeds: Sequence[int], output: Path) -> Path:
    """Write a row for each room: image, depth, truth, our planes by noise; return the path."""
    panels = [panel for seed in seeds for panel in _panels(seed)]
    return write_sheet(output / 'living_rooms.png', panels, 3 + len(SIGMAS), _PANEL_WIDTH_PX)


def _panels(seed: int) -> list[tuple[str, np.ndarray]]:
    """Return titled images of a room; planes are drawn on grey for contrast."""
    scene = furnished(seed)
    grey = grey_of(scene.rgb)
    panels = [(f'seed {seed}', scene.rgb), ('depth', colour_depth(scene.depth_m)),
              (f'truth: {len(scene.planes)} planes', overlay(grey, scene.labels + 1))]
    for sigma in SIGMAS:
        labels, planes = Ours()(noisy_depth(scene, sigma, seed), scene.intrinsics)
        panels.append((f'noise {sigma:g}: {len(planes)} planes', overlay(grey, labels + 1)))
    return panels
