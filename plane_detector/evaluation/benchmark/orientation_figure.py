# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Figure of rendered images with their lines: worst answers and refusals."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import numpy as np

from plane_detector.directions.finder import CameraImage, ImageDirections, find_in_image
from plane_detector.directions.frames import misalignment
from plane_detector.evaluation.benchmark.tables import grey_of, write_sheet
from plane_detector.evaluation.scenes import textures
from plane_detector.evaluation.scenes.rendering import Scene

_PANEL_WIDTH_PX, _COLUMNS, _LINE_WIDTH_PX = 320, 3, 3
# Grey levels of the background, few and bright: noise would make large files.
_GREY_STEP, _DARKEST = 90, 120
# Lines along the vertical, along the two horizontal axes, and along none.
_COLOURS = ((230, 40, 40), (40, 180, 60), (50, 90, 240))
_OTHER = (240, 200, 60)
_ALONG_DEG = 2.5

Panel = tuple[str, np.ndarray]


def write_figure(path: Path, kinds: Mapping[str, Callable], count: int, first_seed: int) -> Path:
    """
    Write, for each kind of scene, the worst answer and the first refusal; then strokes.

    Parameters
    ----------
    path : Path
    kinds : mapping of name to function
        As :func:`plane_detector.evaluation.scenes.textures.textured` takes them.
    count, first_seed : int
        Range of scenes to search.

    """
    panels = [panel for name, make in kinds.items()
              for panel in _extremes(name, make, range(first_seed, first_seed + count))]
    strokes = textures.clutter(np.random.default_rng(first_seed), textures.VGA)
    found = find_in_image(CameraImage(strokes, textures.VGA))
    panels.append(_panel('strokes', strokes, found, None))
    return write_sheet(path, panels, _COLUMNS, _PANEL_WIDTH_PX)


def _extremes(name: str, make: Callable, seeds: range) -> list[Panel]:
    """Return the panels of the worst answer and of the first refusal, if any."""
    short = name.split(', ')[-1].split(' by ')[0]
    worst: tuple[float, Scene, ImageDirections] | None = None
    refused: Panel | None = None
    for seed in seeds:
        scene = textures.textured(make, seed)
        found = find_in_image(CameraImage(scene.rgb, scene.intrinsics))
        if found.directions.gravity_camera is None:
            refused = refused or _panel(short, scene.rgb, found, None)
            continue
        error_deg = np.degrees(np.arccos(np.clip(
            found.directions.gravity_camera @ scene.gravity_camera, -1, 1)))
        if worst is None or error_deg > worst[0]:
            worst = error_deg, scene, found
    answered = [_panel(short, worst[1].rgb, worst[2], worst[0])] if worst else []
    return answered + ([refused] if refused else [])


def _panel(name: str, rgb: np.ndarray, found: ImageDirections, error_deg: float | None) -> Panel:
    """Return the image in grey with its lines, coloured by their direction."""
    image = np.maximum(cv2.medianBlur(grey_of(rgb), 15) // _GREY_STEP * _GREY_STEP, _DARKEST)
    along = np.full(len(found.segments), -1)
    if len(found.axes):
        sine = np.abs(misalignment(found.segments, found.axes))
        along = np.where(sine.min(1) < np.sin(np.radians(_ALONG_DEG)), sine.argmin(1), -1)
    for k, ends in zip(along, np.rint(found.segments.ends_px).astype(int), strict=True):
        cv2.line(image, tuple(ends[0].tolist()), tuple(ends[1].tolist()),
                 _OTHER if k < 0 else _COLOURS[k], _LINE_WIDTH_PX, cv2.LINE_AA)
    told = found.directions.refusal if error_deg is None else f'{error_deg:.2f} deg off'
    return f'{name}: {told}', image
