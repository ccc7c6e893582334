# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Objects on the walls of rendered rooms: pictures, television, door, window, curtains, skirting.

The wall is y = 0 and faces y, z is up from the floor, and the centre of the object is at x = 0;
metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from plane_detector.evaluation.scenes.rendering import Rectangle
from plane_detector.evaluation.scenes.surfaces import (
    Thing,
    bar,
    block,
    ellipsoid,
    joined,
    outside,
    panel,
    sheet,
)


@dataclass(frozen=True)
class Opening:
    """The hole of a window in a wall: its limits in metres, with x from its centre."""

    half_width: float
    low: float
    high: float


def wall(length: float, height: float, hole: Opening | None = None, hole_x: float = 0.0) -> Thing:
    """Return the wall from x = 0 to its length, with or without the hole of a window."""
    face = Rectangle(np.zeros(3), length * np.eye(3)[0], height * np.eye(3)[2])
    if hole is not None:
        face = replace(face, mask=outside(
            ((hole_x - hole.half_width) / length, hole.low / height),
            ((hole_x + hole.half_width) / length, hole.high / height)))
    return Thing((face,))


def picture(rng: np.random.Generator) -> Thing:
    """Return a canvas, or a frame with a recessed picture; its centre is at z = 0."""
    half = rng.uniform([0.15, 0.15], [0.5, 0.4])
    thick, border = rng.uniform([0.015, 0.03], [0.04, 0.07])
    low, high = np.array([-half[0], 0, -half[1]]), np.array([half[0], thick, half[1]])
    if rng.uniform() < 0.3:
        return block(low, high)
    inset = np.array([border, 0, border])
    inside = high - low - 2 * inset
    frame = panel(low, high, outside(border / (2 * half), 1 - border / (2 * half)))
    return frame + _niche(low + inset, inside[0], inside[2], thick, rng.uniform(0.4, 0.7) * thick)


def _niche(corner: Sequence[float], width: float, height: float, front: float,
           back: float) -> Thing:
    """Return the four sides of a niche between two values of y, and its back."""
    across, up = width * np.eye(3)[0], height * np.eye(3)[2]
    deep = (front - back) * np.eye(3)[1]
    corner = np.array([corner[0], back, corner[2]])
    return Thing((Rectangle(corner, across, up), *_sides(corner, across, up, deep)))


def _sides(corner: np.ndarray, across: np.ndarray, up: np.ndarray,
           deep: np.ndarray) -> tuple[Rectangle, ...]:
    return (Rectangle(corner, up, deep), Rectangle(corner + across, up, deep),
            Rectangle(corner, across, deep), Rectangle(corner + up, across, deep))


def television(rng: np.random.Generator) -> Thing:
    """Return a flat screen whose front is 2 to 5 cm from the wall; its centre is at z = 0."""
    half = rng.uniform(0.45, 0.75)
    return block([-half, 0, -0.56 * half], [half, rng.uniform(0.02, 0.05), 0.56 * half])


def door(rng: np.random.Generator) -> Thing:
    """Return a door in a frame 2 to 4 cm in front of the wall, with a handle."""
    half, high, border = rng.uniform([0.4, 1.98, 0.06], [0.48, 2.08, 0.1])
    frame, leaf = rng.uniform([0.02, 0.004], [0.04, 0.012])
    # Slightly below the floor, so that no face is in the plane of the floor.
    low, top = [-half - border, 0, -0.01], [half + border, frame, high + border]
    share = border / (2 * half + 2 * border)
    bar_y = leaf + 0.05
    handle = half - 0.07
    return joined(
        panel(low, top, outside((share, -1), (1 - share, 1 - border / (high + border + 0.01)))),
        _niche((-half, 0, -0.01), 2 * half, high + 0.01, frame, leaf),
        bar([handle - 0.11, bar_y, 1.03], [handle, bar_y, 1.03], 0.011),
        bar([handle, leaf, 1.03], [handle, bar_y, 1.03], 0.011))


def window(rng: np.random.Generator, hole: Opening) -> Thing:
    """Return reveal, frame, sill and pane; some panes show no depth behind them."""
    half, height = hole.half_width, hole.high - hole.low
    deep, border, frame = rng.uniform([0.1, 0.05, 0.03], [0.22, 0.08, 0.05])
    corner = np.array([-half, -deep, hole.low])
    across, up = 2 * half * np.eye(3)[0], height * np.eye(3)[2]
    edge, middle = border / np.array([2 * half, height]), border / (4 * half)

    def bars(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return outside(edge, 1 - edge)(u, v) | (abs(u - 0.5) < middle)

    back = corner - [0, frame, 0]
    faces = [Rectangle(corner, across, up, mask=bars),
             *_sides(corner, across, up, deep * np.eye(3)[1])]
    for left, right in ((border, half - border / 2), (half + border / 2, 2 * half - border)):
        faces += _sides(back + [left, 0, border], (right - left) * np.eye(3)[0],
                        (height - 2 * border) * np.eye(3)[2], frame * np.eye(3)[1])
    if rng.uniform() < 0.6:
        faces.append(Rectangle(back, across, up))
    sill = rng.uniform(0.03, 0.15)
    return Thing(tuple(faces)) + block([-half - 0.04, -deep + 0.001, hole.low - 0.03],
                                       [half + 0.04, sill, hole.low + 0.005])


def curtains(rng: np.random.Generator, hole: Opening) -> Thing:
    """Return two wavy sheets at the sides of a window, on a rod with knobs."""
    amplitude, wave, bottom = rng.uniform([0.02, 0.08, 0.02], [0.05, 0.16, 0.15])
    top, y = hole.high + 0.12, 0.17 + amplitude
    end = hole.half_width + 0.15
    parts = [bar([-end, y, top], [end, y, top], 0.012)]
    for side in (-1, 1):
        parts.append(ellipsoid(0.025, 0.025).at(side * end, y, top))
        x = np.arange(0, rng.uniform(0.3, 0.6), 0.0015)
        phase = 2 * np.pi * x / wave + rng.uniform(0, 6)
        # Uneven folds, so that no two of them are parallel.
        swing = amplitude * np.sin(phase + 0.8 * np.sin(0.37 * phase))
        profile = np.stack([side * (end - 0.02 - x), y + swing, np.full(len(x), bottom)], axis=1)
        parts.append(sheet(profile, np.array([0, 0, top - bottom])))
    return joined(*parts)


def radiator(rng: np.random.Generator, hole: Opening) -> Thing:
    """Return a flat radiator below a window."""
    half = hole.half_width * rng.uniform(0.6, 0.9)
    return block([-half, 0.03, 0.12], [half, rng.uniform(0.08, 0.12), hole.low - 0.12])


def skirting(spans: Sequence[tuple[float, float]], height: float, thick: float) -> Thing:
    """Return boards along the foot of a wall, each between two values of x."""
    return joined(*(block([low, 0, 0], [high, thick, height]) for low, high in spans))
