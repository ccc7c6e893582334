# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Exports of a replay: a figure and a cloud per frame, tables of all frames."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import TextIO

import cv2
import numpy as np

from plane_detector import drawing
from plane_detector.geometry.projection import depth_to_points
from plane_detector.ros.frame_processor import FrameOutputs
from plane_detector.ros.outputs.frame import ProcessedFrame
from plane_detector.ros.outputs.plane_table import PLANE_DTYPE
from plane_detector.ros.outputs.shapes import SHAPE_DTYPE
from plane_detector.ros.stamps import stamp_text
from plane_detector.scale.estimate import RELATIVE
from plane_detector.tools.ply import write_ply
from plane_detector.tools.replay.bag_writer import Draft


class ReplayFiles:
    """
    Writes a figure, a labelled cloud and rows of tables for each frame; a context manager.

    Parameters
    ----------
    figures, ply : Path, optional
        Folders of the figures (.jpg) and of the clouds, created if needed.
    table : Path, optional
        CSV file of all planes of all frames, and ``<stem>_shapes.csv`` of all shapes if these are
        wanted; they get their names by :meth:`publish`.

    Raises
    ------
    OSError
        A folder or a table cannot be written.

    """

    def __init__(self, figures: Path | None = None, ply: Path | None = None,
                 table: Path | None = None, shapes: bool = False):
        self._figures, self._ply = figures, ply
        self._tables: dict[str, tuple[Path, np.dtype]] = {}
        if table is not None:
            self._tables['planes'] = table, PLANE_DTYPE
            if shapes:
                beside = table.with_name(f'{table.stem}_shapes.csv')
                self._tables['shapes'] = beside, SHAPE_DTYPE
        self._files: dict[str, TextIO] = {}
        self._drafts: list[Draft] = []
        self._opened = ExitStack()

    def __enter__(self) -> ReplayFiles:
        for folder in filter(None, (self._figures, self._ply)):
            folder.mkdir(parents=True, exist_ok=True)
            with NamedTemporaryFile(dir=folder):  # checked now: the first frame comes much later
                pass
        for name, (table, dtype) in self._tables.items():
            draft = self._opened.enter_context(Draft(table))
            file = self._opened.enter_context(
                open(draft.path, 'w', newline='', encoding='utf-8'))
            csv.writer(file).writerow(['frame', 'stamp', *dtype.names])
            self._drafts.append(draft)
            self._files[name] = file
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def publish(self, prefix: str = '') -> None:
        """Give the tables their names, see :class:`Draft`."""
        for file, draft in zip(self._files.values(), self._drafts, strict=True):
            file.flush()
            draft.publish(prefix)

    @property
    def is_wanted(self) -> bool:
        """Whether any file is written."""
        return any((self._figures, self._ply, self._tables))

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs that these files are made from."""
        return tuple(self._tables)

    def write(self, index: int, processed: FrameOutputs) -> None:
        """Write the files of a frame, whose number is in their names."""
        result = processed.result
        if self._figures is not None:
            bgr = cv2.cvtColor(_figure(result), cv2.COLOR_RGB2BGR)
            with _whole(self._figures / f'{index:06d}.jpg') as path:
                if not cv2.imwrite(str(path), bgr):
                    raise OSError(f'{path} cannot be written')
        if self._ply is not None:
            points_m = depth_to_points(result.detection.depth_m, result.intrinsics)
            with _whole(self._ply / f'{index:06d}.ply') as path:
                write_ply(path, points_m, drawing.tint(result.rgb, result.labels), result.labels,
                          in_metres=result.detection.scale_method != RELATIVE)
        for name, file in self._files.items():
            csv.writer(file).writerows(_rows(index, processed, name, self._tables[name][1]))


@contextmanager
def _whole(path: Path) -> Iterator[Path]:
    """Yield the path to write a file to, which then gets its name."""
    draft = path.with_name(f'.{path.name}')
    yield draft
    os.replace(draft, path)


def _figure(result: ProcessedFrame) -> np.ndarray:
    """Return image, depth and planes side by side."""
    detection = result.detection
    near, far = drawing.depth_range(detection.depth_m)
    unit = 'units' if detection.scale_method == RELATIVE else 'm'
    return drawing.figure([
        (f'image of {stamp_text(result)}', result.rgb),
        (f'depth, red {near:.1f} {unit} to blue {far:.1f} {unit}',
         drawing.colour_depth(detection.depth_m)),
        (f'{len(detection.planes)} planes', drawing.overlay(result.rgb, result.labels)),
    ], columns=3)


def _rows(index: int, processed: FrameOutputs, name: str,
          dtype: np.dtype) -> Iterator[list[object]]:
    """Yield the content of the message of planes or shapes, one row per point."""
    stamp = stamp_text(processed.result)
    for point in np.frombuffer(processed.messages[name].data, dtype):
        yield [index, stamp, *(
            f'{value:.6g}' if isinstance(value, np.floating) else value for value in point)]
