# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Furniture of random sizes for rendered rooms, and what is on their walls.

Everything stands on z = 0, in metres. What is at a wall has its back at y = 0, its centre at
x = 0 and faces y; other furniture has the origin in its centre. Faces of adjacent parts are never
flush, so that each visually flat surface is one plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from plane_detector.evaluation.scenes.rendering import Rectangle
from plane_detector.evaluation.scenes.surfaces import (
    Thing,
    bar,
    bezier,
    block,
    cone,
    disc,
    drum,
    ellipsoid,
    joined,
    outside,
    panel,
    sheet,
)

X = (1, 0, 0)


def sofa(rng: np.random.Generator, least_width: float = 1.5, most_width: float = 2.3) -> Thing:
    """Return a sofa: base, arms, back, cushions with individual tilts, and round pillows."""
    width, depth = rng.uniform([least_width, 0.8], [most_width, 1.0])
    arm, back = rng.uniform([0.12, 0.12], [0.25, 0.2])
    arm_height, back_height, seat = rng.uniform([0.55, 0.72, 0.26], [0.68, 0.9, 0.32])
    inner, thick = width - 2 * arm, rng.uniform(0.12, 0.17)
    parts = [block([-inner / 2, 0.01, 0.08], [inner / 2, depth - 0.03, seat]),
             block([-inner / 2, 0, 0.1], [inner / 2, back, back_height])]
    for left in (-width / 2, inner / 2):
        parts.append(block([left, 0.005, 0.06], [left + arm, depth, arm_height]))
        parts += _legs((left + arm / 2,), (0.08, depth - 0.08), 0.06, 0.05)
    count = 1 if width < 1.2 else 2 + int(width > 1.9)
    for k in range(count):
        x = inner * ((k + 0.5) / count - 0.5)
        parts.append(_seat_and_back(rng, inner / count - 0.01, depth - 0.06, back, thick)
                     .at(x, 0, seat))
    for x in rng.uniform(-0.4, 0.4, rng.integers(3)) * inner:
        pillow = ellipsoid(rng.uniform(0.18, 0.24), rng.uniform(0.06, 0.09))
        parts.append(pillow.turned(X, rng.uniform(-75, -60)).at(
            x, back + 0.33, seat + thick + 0.2, rng.uniform(-20, 20)))
    return joined(*parts)


def _seat_and_back(rng: np.random.Generator, width: float, depth: float, back: float,
                   thick: float) -> Thing:
    """Return the seat cushion and the back cushion, tilted by 5 to 20 degrees."""
    lean_deg, length = rng.uniform([5, 0.38], [20, 0.48])
    back_thick = rng.uniform(0.09, 0.13)
    foot = back + back_thick + length * np.sin(np.radians(lean_deg))
    seat = _cushion(width, depth - back, thick).turned(X, rng.uniform(1, 4))
    leaning = _cushion(width, length, back_thick).turned(X, 90 + lean_deg)
    return (seat.at(0, back, rng.uniform(-0.035, -0.015))
            + leaning.at(0, foot, thick + rng.uniform(0, 0.02)))


def _cushion(width: float, length: float, thick: float) -> Thing:
    """Return a cushion along y that is round at its far end."""
    flat_end = length - thick / 2
    return (block([-width / 2, 0, 0], [width / 2, flat_end, thick])
            + bar([-width / 2, flat_end, thick / 2], [width / 2, flat_end, thick / 2], thick / 2))


def lounge_chair(rng: np.random.Generator) -> Thing:
    """Return a chair made of a bent sheet between two bent arms, facing y."""
    half, high = rng.uniform([0.25, 0.85], [0.34, 1.05])
    seat = bezier([(-half, 0.40, 0.42), (-half, -0.05, 0.25), (-half, -0.25, 0.28),
                   (-half, -0.45, high)], 800)
    parts = [sheet(seat, np.array([2 * half, 0, 0]))]
    for left in (-half - 0.06, half + 0.01):
        arm = bezier([(left, 0.35, 0.0), (left, 0.75, 0.75), (left, 0.1, 0.7),
                      (left, -0.38, 0.62)], 200)
        foot = bezier([(left, 0.35, 0.0), (left, 0.1, 0.01), (left, -0.1, 0.01),
                       (left, -0.45, 0.03)], 100)
        parts += [sheet(curve, np.array([0.05, 0, 0])) for curve in (arm, foot)]
    return joined(*parts)


def table(rng: np.random.Generator, low: tuple, high: tuple) -> Thing:
    """Return a table with a size between two, with four legs or, if round, with one."""
    width, depth, height = rng.uniform(low, high)
    thick = rng.uniform(0.025, 0.05)
    if rng.uniform() < 0.25:
        return joined(drum(depth / 2, height - thick, height), drum(depth / 4, 0, 0.02),
                      cone(0.04, 0.04, 0.02, height - thick))
    leg, inset = rng.uniform([0.04, 0.01], [0.08, 0.08])
    x, y = width / 2 - inset - leg / 2, depth / 2 - inset - leg / 2
    parts = [block([-width / 2, -depth / 2, height - thick], [width / 2, depth / 2, height])]
    parts += _legs((-x, x), (-y, y), height - thick, leg)
    if rng.uniform() < 0.3:
        parts.append(block([-x, -y, 0.15], [x, y, 0.17]))
    return joined(*parts)


def _legs(xs: tuple, ys: tuple, height: float, width: float) -> list[Thing]:
    half = width / 2
    return [block([x - half, y - half, 0], [x + half, y + half, height]) for x in xs for y in ys]


def on_table(rng: np.random.Generator) -> Thing:
    """Return objects for a table: a vase, a bowl, a flat box or some books."""
    kind = rng.integers(4)
    if kind == 0:
        return vase(rng)
    if kind == 1:
        radius = rng.uniform(0.1, 0.17)
        return ellipsoid(radius, radius * 0.9, rng.uniform(0.3, 0.5)).at(0, 0, radius * 0.9)
    width, depth, height = rng.uniform([0.15, 0.12, 0.015], [0.32, 0.24, 0.07])
    lying = block([-width / 2, -depth / 2, 0], [width / 2, depth / 2, height])
    if kind == 3:
        lying += block([-width / 2.4, -depth / 2.4, height],
                       [width / 2.4, depth / 2.4, height + 0.03]).at(0, 0, 0, 12)
    return lying.at(0, 0, 0, rng.uniform(-40, 40))


def vase(rng: np.random.Generator) -> Thing:
    """Return a round belly with a neck."""
    radius, belly, neck = rng.uniform([0.06, 0.1, 0.03], [0.14, 0.18, 0.05])
    return (ellipsoid(radius, belly, 0.95).at(0, 0, belly)
            + cone(neck, neck * 1.3, 1.85 * belly, 2.3 * belly))


def chair(rng: np.random.Generator) -> Thing:
    """Return a dining chair that faces y; its back is a tilted board or slats."""
    width, depth, height = rng.uniform([0.4, 0.4, 0.43], [0.48, 0.46, 0.48])
    leg, thick, tilt_deg = rng.uniform([0.035, 0.025, 5], [0.05, 0.05, 12])
    x, y = width / 2 - leg / 2 - 0.012, depth / 2 - leg / 2 - 0.012
    parts = [block([-width / 2, -depth / 2, height - thick], [width / 2, depth / 2, height])]
    parts += _legs((-x, x), (-y, y), height - thick, leg)
    top, post = rng.uniform([0.42, 0.025], [0.5, 0.04])
    back = [block([a * x - post / 2, 0, 0], [a * x + post / 2, post, top]) for a in (-1, 1)]
    slats = rng.integers(1, 4)
    for low in 0.12 + (top - 0.12) * np.arange(slats) / slats:
        high = low + (top - 0.14) / slats - (0.05 if slats > 1 else 0)
        back.append(block([-x, 0.008, low], [x, post - 0.006, high]))
    tilted = joined(*back).turned(X, tilt_deg)
    return joined(*parts, tilted.at(0, -depth / 2 + 0.01, height))


def bookshelf(rng: np.random.Generator) -> Thing:
    """Return sides, boards slightly set back, a back wall, and books on most boards."""
    width, depth, height = rng.uniform([0.6, 0.25, 1.2], [1.2, 0.36, 2.1])
    half, board = width / 2, rng.uniform(0.018, 0.03)
    parts = [block([-half, 0, 0], [half, 0.008, height - 0.01])]
    parts += [block([x, 0.004, 0], [x + board, depth, height]) for x in (-half, half - board)]
    gap = (height - 0.06) / rng.integers(3, 6)
    for z in np.arange(0.05, height, gap):
        parts.append(block([0.001 - half, 0.004, z], [half - 0.001, depth - 0.01, z + board]))
        if z + gap < height and rng.uniform() < 0.8:
            parts.append(_books(rng, width - 2 * board, depth, gap - board - 0.02)
                         .at(-half + board, 0, z + board - 0.001))
    return joined(*parts)


def _books(rng: np.random.Generator, width: float, depth: float, room: float) -> Thing:
    """Return books side by side from x = 0, their spines 1 to 6 cm behind the shelf's front."""
    parts, x = [], 0.0
    end = width * rng.uniform(0.5, 0.98)
    while x < end - 0.06:
        thick, back = rng.uniform([0.015, 0.02], [0.055, 0.07])
        high = min(room, rng.uniform(0.17, 0.31))
        parts.append(block([x, 0.03, 0], [x + thick, depth - back, high]))
        x += thick + rng.uniform(0.0005, 0.002) + (rng.uniform() < 0.1) * 0.05
    return joined(*parts)


def cupboard(rng: np.random.Generator, low: tuple, high: tuple) -> Thing:
    """Return a body on a recessed plinth below a protruding top, with knobs."""
    width, depth, height = rng.uniform(low, high)
    out = rng.uniform(0.01, 0.03)
    parts = [block([-width / 2 + 0.02, 0.01, 0], [width / 2 - 0.02, depth - 0.05, 0.08]),
             block([-width / 2, 0, 0.08], [width / 2, depth, height - 0.03]),
             block([-width / 2 - out, 0, height - 0.03], [width / 2 + out, depth + out, height])]
    parts += [ellipsoid(0.018, 0.018).at(x, depth + 0.015, 0.6 * height)
              for x in (-0.06, 0.06)]
    return joined(*parts)


def television_bench(rng: np.random.Generator) -> Thing:
    """Return a low bench: two bodies with an open niche between, on feet."""
    width, depth, height = rng.uniform([1.2, 0.35, 0.4], [1.9, 0.48, 0.58])
    half, niche = width / 2, width * rng.uniform(0.1, 0.2)
    bottom, under = 0.1, height - 0.03
    parts = [block([-half - 0.01, 0, under], [half + 0.01, depth + 0.01, height]),
             block([-niche, 0.01, bottom], [niche, depth - 0.015, bottom + 0.02]),
             block([-niche, 0.01, bottom + 0.02], [niche, 0.02, under])]
    parts += [block([x, 0.005, bottom - 0.01], [x + half - niche, depth, under])
              for x in (-half, niche)]
    return joined(*parts, *_legs((-half + 0.1, half - 0.1), (0.1, depth - 0.1), bottom, 0.05))


def floor_lamp(rng: np.random.Generator) -> Thing:
    """Return a foot, a pole, and a ball or a shade."""
    height, radius = rng.uniform([1.3, 0.12], [1.7, 0.2])
    parts = [drum(0.15, 0, 0.025), cone(0.015, 0.015, 0.025, height)]
    if rng.uniform() < 0.5:
        return joined(*parts, ellipsoid(radius, radius).at(0, 0, height))
    return joined(*parts, cone(1.2 * radius, 0.7 * radius, height - 0.15, height + 0.12))


def pendant_lamp(rng: np.random.Generator) -> Thing:
    """Return a ball on a cord that hangs from z = 0."""
    length, radius = rng.uniform([0.4, 0.12], [0.8, 0.22])
    return bar([0, 0, -length], [0, 0, 0], 0.006) + ellipsoid(radius, radius).at(0, 0, -length)


def plant(rng: np.random.Generator) -> Thing:
    """Return a pot with earth in it and with leaves."""
    pot, size = rng.uniform([0.1, 0.1], [0.2, 0.17])
    parts = [cone(0.75 * pot, pot, 0, 1.7 * pot), disc(0.95 * pot, 1.5 * pot)]
    for k in range(rng.integers(10, 18)):
        tilt_deg, up = rng.uniform([20, 0], [75, 0.7])
        leaf = ellipsoid(size, 0.02).at(0, 1.2 * size, 0).turned(X, tilt_deg)
        parts.append(leaf.at(0, 0, 1.7 * pot + up, 360 * k * 0.382))
    return joined(*parts, cone(0.015, 0.015, 1.5 * pot, 1.7 * pot + 0.7))


def pouf(rng: np.random.Generator) -> Thing:
    """Return a round stool."""
    return drum(*rng.uniform([0.2, 0.05, 0.35], [0.32, 0.06, 0.45]))


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
