# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Rendered lived-in rooms, with many thin, tilted or curved objects.

One wall has the sofa, the opposite one the television, the others a window and a door.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from plane_detector.evaluation.scenes import furniture, wall_fittings
from plane_detector.evaluation.scenes.rendering import (
    VGA,
    Rectangle,
    Scene,
    camera_rotation,
    render,
)
from plane_detector.evaluation.scenes.surfaces import Thing, block, drum, joined
from plane_detector.types import CameraIntrinsics

_TRIES = 30
_NEAREST_M, _NEAREST_TARGET_M = 0.5, 1.8
Pose = tuple[float, float, float, float]
"""x, y, z in metres and yaw in degrees."""


def living_room(rng: np.random.Generator, intrinsics: CameraIntrinsics = VGA) -> Scene:
    """Return a living room seen from a random position, 0.9 to 1.8 m above the floor."""
    things, rotation, position = furnished_living_room(rng)
    everything = joined(*(thing for _, thing in things))
    return render(everything.flat, rotation, position, intrinsics, rng,
                  everything.curved_pieces())


def furnished_living_room(
        rng: np.random.Generator) -> tuple[list[tuple[str, Thing]], np.ndarray, np.ndarray]:
    """Return the objects of a room, by name, and rotation (3, 3) and position (3,) of a camera."""
    room = _Room(rng)
    sides = np.roll([0, 1, 2, 3] if rng.uniform() < 0.5 else [0, 3, 2, 1], rng.integers(4))
    for furnish, side in zip((_sofa_wall, _window_wall, _television_wall, _door_wall), sides,
                             strict=True):
        furnish(room, int(side))
    _middle(room, int(sides[0]))
    return room.things, *room.camera()


class _Room:
    """A room that is being furnished, and the occupied boxes in it."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.size = rng.uniform([3.6, 3.6, 2.35], [5.5, 5.5, 2.8])
        self.skirting = rng.uniform([0.06, 0.01], [0.14, 0.02])
        self.taken: list[np.ndarray] = []
        floor = np.zeros(3), self.size[0] * np.eye(3)[0], self.size[1] * np.eye(3)[1]
        ceiling = floor[0] + [0, 0, self.size[2]], *floor[1:]
        self.things = [('floor', Thing((Rectangle(*floor),))),
                       ('ceiling', Thing((Rectangle(*ceiling),)))]

    def length(self, side: int) -> float:
        """Return the length of a wall."""
        return float(self.size[side % 2])

    def on_wall(self, thing: Thing, side: int, x: float, y: float = 0.0, z: float = 0.0) -> Thing:
        """Return a thing moved from the centre of y = 0 to a place on a wall."""
        corner = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])[side] * self.size[:2]
        return thing.at(x, y, z).at(*corner, 0, 90.0 * side)

    def put(self, name: str, thing: Thing, keep_clear_m: float = 0.0) -> None:
        """Add a thing at its current place."""
        self.things.append((name, thing))
        self.taken.append(thing.bounds() + keep_clear_m * np.array([[-1, -1, 0], [1, 1, 0]]))

    def try_to_put(self, name: str, thing: Thing, moved: Callable[[Thing], Thing]) -> Thing | None:
        """Add a thing at the first random place that is free and in the room, if any."""
        for _ in range(_TRIES):
            there = moved(thing)
            low, high = there.bounds()
            inside = (low > -1e-6).all() and (high < self.size + 1e-6).all()
            if inside and not any((low < other[1]).all() and (high > other[0]).all()
                                  for other in self.taken):
                self.put(name, there)
                return there
        return None

    def try_on_wall(self, name: str, thing: Thing, side: int, low: tuple,
                    high: tuple) -> Thing | None:
        """Add a thing on a wall within a range (x as a share of its length, y, z), if it fits."""
        def moved(thing: Thing) -> Thing:
            share, y, z = self.rng.uniform(low, high)
            return self.on_wall(thing, side, share * self.length(side), y, z)
        return self.try_to_put(name, thing, moved)

    def try_on_floor(self, name: str, thing: Thing) -> Thing | None:
        """Add a thing anywhere on the floor, if it fits."""
        def moved(thing: Thing) -> Thing:
            return thing.at(*self.rng.uniform(0, self.size[:2]), 0, self.rng.uniform(0, 360))
        return self.try_to_put(name, thing, moved)

    def put_on(self, name: str, thing: Thing, below: Thing) -> None:
        """Add a thing on top of another, away from its edges, if there is space."""
        low, high = below.bounds()

        def moved(thing: Thing) -> Thing:
            x, y = low[:2] + self.rng.uniform(0.25, 0.75, 2) * (high - low)[:2]
            return thing.at(x, y, high[2], self.rng.uniform(-90, 90))
        self.try_to_put(name, thing, moved)

    def put_skirting(self, side: int, door: tuple[float, float] | None = None) -> None:
        """Add the skirting boards of a wall, except at its door."""
        spans = [(0.0, self.length(side))]
        if door is not None:
            spans = [(0.0, door[0]), (door[1], self.length(side))]
        board = wall_fittings.skirting(spans, *self.skirting)
        self.things.append(('skirting', self.on_wall(board, side, 0)))

    def camera(self) -> tuple[np.ndarray, np.ndarray]:
        """Return rotation and position of a camera that looks between two things at a distance."""
        boxes = np.array(self.taken)
        for less in 0.99 ** np.arange(1000):  # the requirements decrease with each try
            position = self.rng.uniform([0.3, 0.3, 0.9], [*self.size[:2] - 0.3, 1.8])
            outside = position - np.clip(position, boxes[:, 0], boxes[:, 1])
            away = boxes[self.rng.integers(len(boxes), size=2)].mean((0, 1)) - position
            away_m, near_m = np.hypot(*away[:2]), np.linalg.norm(outside, axis=1).min()
            if near_m > less * _NEAREST_M and away_m > less * _NEAREST_TARGET_M:
                break
        pitch_deg = np.degrees(np.arctan2(away[2], away_m)) + self.rng.uniform(-8, 2)
        yaw_deg = np.degrees(np.arctan2(-away[0], away[1])) + self.rng.uniform(-12, 12)
        return camera_rotation(yaw_deg, np.clip(pitch_deg, -28, 8),
                               self.rng.uniform(-4, 4)), position


def _sofa_wall(room: _Room, side: int) -> None:
    """Add a sofa, pictures above it, and a lamp and a small table at its sides."""
    rng = room.rng
    _plain_wall(room, side)
    sofa = room.on_wall(furniture.sofa(rng), side, rng.uniform(0.42, 0.58) * room.length(side),
                        rng.uniform(0.03, 0.15))
    room.put('sofa', sofa)
    for _ in range(rng.integers(1, 4)):
        room.try_on_wall('picture', wall_fittings.picture(rng), side, (0.2, 0, 1.4), (0.8, 0, 1.8))
    if rng.uniform() < 0.7:
        room.try_on_wall('lamp', furniture.floor_lamp(rng), side, (0.02, 0.25, 0), (0.98, 0.35, 0))
    small = furniture.table(rng, (0.4, 0.38, 0.4), (0.5, 0.5, 0.55))
    small = room.try_on_wall('side table', small, side, (0.02, 0.3, 0), (0.98, 0.4, 0))
    if small is not None:
        room.put_on('on table', furniture.on_table(rng), small)


def _plain_wall(room: _Room, side: int) -> None:
    wall = wall_fittings.wall(room.length(side), room.size[2])
    room.things.append(('wall', room.on_wall(wall, side, 0)))
    room.put_skirting(side)


def _television_wall(room: _Room, side: int) -> None:
    """Add a bench with a television above, a shelf with books, and a plant."""
    rng = room.rng
    _plain_wall(room, side)
    share = rng.uniform(0.35, 0.65)
    bench = room.on_wall(furniture.television_bench(rng), side, share * room.length(side), 0.03)
    room.put('bench', bench)
    middle = (share, 0, 1.2), (share, 0, 1.35)
    room.try_on_wall('television', wall_fittings.television(rng), side, *middle)
    for _ in range(rng.integers(0, 3)):
        room.put_on('on table', furniture.on_table(rng), bench)
    room.try_on_wall('bookshelf', furniture.bookshelf(rng), side, (0, 0.03, 0), (1, 0.05, 0))
    room.try_on_wall('plant', furniture.plant(rng), side, (0, 0.3, 0), (1, 0.45, 0))
    room.try_on_wall('picture', wall_fittings.picture(rng), side, (0.1, 0, 1.4), (0.9, 0, 1.8))


def _window_wall(room: _Room, side: int) -> None:
    """Add a window with sill, curtains and the objects below it."""
    rng = room.rng
    half, low, top = rng.uniform([0.5, 0.65, 0.2], [0.95, 0.95, 0.45])
    hole = wall_fittings.Opening(half, low, room.size[2] - top)
    x = rng.uniform(0.4, 0.6) * room.length(side)
    wall = wall_fittings.wall(room.length(side), room.size[2], hole, x)
    room.things.append(('wall', room.on_wall(wall, side, 0)))
    room.put_skirting(side)
    room.put('window', room.on_wall(wall_fittings.window(rng, hole), side, x))
    room.put('curtains', room.on_wall(wall_fittings.curtains(rng, hole), side, x))
    if rng.uniform() < 0.5:
        room.put('radiator', room.on_wall(wall_fittings.radiator(rng, hole), side, x))
    if rng.uniform() < 0.6:
        room.put('on sill', room.on_wall(furniture.vase(rng), side, x + rng.uniform(-0.3, 0.3),
                                         0.03, low + 0.005))


def _door_wall(room: _Room, side: int) -> None:
    """Add a door, a cupboard and pictures."""
    rng = room.rng
    x = rng.uniform(0.25, 0.75) * room.length(side)
    door = wall_fittings.door(rng)
    low, high = door.bounds()[:, 0] + x
    wall = wall_fittings.wall(room.length(side), room.size[2])
    room.things.append(('wall', room.on_wall(wall, side, 0)))
    room.put_skirting(side, (low, high))
    room.put('door', room.on_wall(door, side, x), keep_clear_m=0.5)
    high_or_low = ((0.7, 0.35, 0.75), (1.3, 0.45, 1.1)) if rng.uniform() < 0.5 else (
        (0.6, 0.4, 1.7), (1.0, 0.6, 2.1))
    cupboard = room.try_on_wall('cupboard', furniture.cupboard(rng, *high_or_low), side,
                                (0, 0.03, 0), (1, 0.05, 0))
    if cupboard is not None and cupboard.bounds()[1, 2] < 1.2:
        room.put_on('on table', furniture.on_table(rng), cupboard)
    for _ in range(rng.integers(1, 3)):
        room.try_on_wall('picture', wall_fittings.picture(rng), side, (0.1, 0, 1.4), (0.9, 0, 1.8))


def _middle(room: _Room, side: int) -> None:
    """Add free-standing objects: coffee table on a rug at the sofa, chairs, a plant, a lamp."""
    rng = room.rng
    ahead = rng.uniform(1.55, 1.75)
    x = rng.uniform(0.45, 0.55) * room.length(side)
    half = rng.uniform([0.8, 0.55], [1.2, 0.85])
    thick = rng.uniform(0.008, 0.012)
    rug = block([*-half, 0], [*half, thick]) if rng.uniform() < 0.7 else drum(half[1], 0, thick)
    room.things.append(('rug', room.on_wall(rug.at(0, 0, 0, rng.uniform(-8, 8)), side, x, ahead)))
    coffee = furniture.table(rng, (0.8, 0.45, 0.35), (1.3, 0.7, 0.48))
    coffee = room.on_wall(coffee.at(0, 0, 0, rng.uniform(-6, 6)), side, x, ahead, thick)
    room.put('coffee table', coffee)
    for _ in range(rng.integers(1, 4)):
        room.put_on('on table', furniture.on_table(rng), coffee)
    other = furniture.lounge_chair(rng) if rng.uniform() < 0.6 else furniture.sofa(rng, 0.75, 0.95)
    room.try_on_floor('armchair', other)
    for _ in range(rng.integers(1, 4)):
        room.try_on_floor('chair', furniture.chair(rng))
    for name, make in (('pouf', furniture.pouf), ('plant', furniture.plant)):
        if rng.uniform() < 0.5:
            room.try_on_floor(name, make(rng))
    if rng.uniform() < 0.4:
        place = rng.uniform(0.3, 0.7, 2) * room.size[:2]
        room.put('pendant', furniture.pendant_lamp(rng).at(*place, room.size[2]))
