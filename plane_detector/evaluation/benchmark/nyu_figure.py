# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Figure 2 of the paper: image, RANSAC alone, RANSAC with clustering, ours, outside methods."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from plane_detector.drawing import overlay
from plane_detector.evaluation.benchmark.nyu_frames import (
    NETWORK,
    OURS,
    SENSOR,
    Task,
    opened,
    outside_segments,
    segmentations,
)
from plane_detector.evaluation.benchmark.tables import grey_of, write_sheet
from plane_detector.evaluation.nyu_depth import NyuFrame

COLUMNS = ('ransac', 'paper', OURS)
_PANEL_WIDTH_PX = 400

Panel = tuple[str, np.ndarray]


def write_figures(task: Task, numbers: Sequence[int], folder: Path) -> Iterator[Path]:
    """
    Write a figure for each source of depth, with a row for each frame.

    Parameters
    ----------
    task : Task
        Its methods are ignored: the columns are always those of the paper.
    numbers : sequence of int
        Frames; if empty, no figure is written.
    folder : Path

    Yields
    ------
    Path
        ``figure2_sensor.png`` and, with a network, ``figure2_network.png``.

    """
    if not numbers:
        return
    rows = [_row(replace(task, methods=COLUMNS), opened(task.path).frame(number, task.depth))
            for number in numbers]
    for source in (SENSOR, NETWORK) if task.model else (SENSOR,):
        panels = [panel for row in rows for panel in row[source]]
        columns = len(rows[0][source])
        yield write_sheet(folder / f'figure2_{source}.png', panels, columns, _PANEL_WIDTH_PX)


def _row(task: Task, frame: NyuFrame) -> dict[str, list[Panel]]:
    """Return the panels of a frame by source of depth."""
    grey = grey_of(frame.rgb)
    rows: dict[str, list[Panel]] = {source: [(f'frame {frame.number}', frame.rgb)]
                                    for source in (SENSOR, NETWORK)}
    for name, (labels, planes), _ in segmentations(task, frame):
        method, _, source = name.rpartition(', ')
        rows[source].append((f'{method}: {len(planes)}', overlay(grey, labels + 1)))
    for name, folder in task.outside:
        segments = outside_segments(folder, frame)
        panel = ((f'{name}: no label image', np.full_like(grey, 255)) if segments is None else
                 (f'{name}: {len(segments[1])}', overlay(grey, segments[0] + 1)))
        for row in rows.values():
            row.append(panel)
    return rows
