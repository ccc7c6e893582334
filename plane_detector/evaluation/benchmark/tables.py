# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Markdown tables and contact sheets."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from plane_detector.drawing import figure


def table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a Markdown table; numbers are given as text."""
    lines = [header, ['---'] * len(header), *rows]
    return '\n'.join('| ' + ' | '.join(str(cell) for cell in line) + ' |' for line in lines)


def emit(*blocks: str) -> None:
    """Print blocks of Markdown, each followed by an empty line, without delay."""
    for block in blocks:
        print(f'{block}\n', flush=True)


def write_sheet(path: Path, panels: Sequence[tuple[str, np.ndarray]], columns: int,
                width_px: int) -> Path:
    """
    Write a contact sheet of titled images (H, W, 3) uint8 RGB, each reduced to one width.

    Returns
    -------
    Path
        Its path; the folder is created.

    Raises
    ------
    OSError
        It cannot be written.

    """
    path.parent.mkdir(parents=True, exist_ok=True)
    shrunk = [(title, cv2.resize(
        image, (width_px, round(width_px * image.shape[0] / image.shape[1])),
        interpolation=cv2.INTER_AREA)) for title, image in panels]
    if not cv2.imwrite(str(path), figure(shrunk, columns)[..., ::-1]):
        raise OSError(f'{path} cannot be written')
    return path


def grey_of(rgb: np.ndarray) -> np.ndarray:
    """Return an image without colours, (H, W, 3) uint8, to draw planes on."""
    return cv2.cvtColor(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
