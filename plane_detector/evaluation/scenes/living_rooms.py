# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Rendered lived-in rooms, with many thin, tilted or curved objects.

One wall has the sofa, the opposite one the television, the others a window and a door.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from plane_detector.evaluation.scenes import furniture
from plane_detector.evaluation.scenes.rendering import (
    VGA,
    Scene,
    camera_rotation,
    rectangle,
    render,
)
from plane_detector.evaluation.scenes.surfaces import Thing, block, drum, joined
from plane_detector.types import CameraIntrinsics

_TRIES = 30
_NEAREST_M, _NEAREST_TARGET_M = 0.5, 1.8
ALWAYS = (1, 2)


def living_room(rng: np.random.Generator, intrinsics: CameraIntrinsics = VGA) -> Scene:
    """Return a living room seen from a random position, 0.9 to 1.8 m above the floor."""
    room = _Room(rng)
    sides = np.roll([0, 1, 2, 3] if rng.uniform() < 0.5 else [0, 3, 2, 1], rng.integers(4))
    for furnish, side in zip((_sofa_wall, _window_wall, _television_wall, _door_wall), sides,
                             strict=True):
        furnish(room, int(side))
    _middle(room, int(sides[0]))
    rotation, position = room.camera()
    everything = joined(*room.things)
    return render(everything.flat, rotation, position, intrinsics, rng,
                  everything.curved_pieces())


class _Room:
    """A room that is being furnished, and the occupied boxes in it."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.size = x, y, z = rng.uniform([3.6, 3.6, 2.35], [5.5, 5.5, 2.8])
        self.skirting = rng.uniform([0.06, 0.01], [0.14, 0.02])
        self.taken: list[np.ndarray] = []
        self.things = [Thing((rectangle([0, 0, height], [x, 0, 0], [0, y, 0]),))
                       for height in (0, z)]

    def length(self, side: int) -> float:
        """Return the length of a wall."""
        return float(self.size[side % 2])

    def count(self, often: float | tuple[int, int]) -> int:
        """Return a random number of objects."""
        if isinstance(often, float):
            return int(self.rng.uniform() < often)
        return 1 if often == ALWAYS else int(self.rng.integers(*often))

    def on_wall(self, thing: Thing, side: int, x: float, y: float = 0.0, z: float = 0.0) -> Thing:
        """Return an object moved from the centre of y = 0 to a place on a wall."""
        corner = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])[side] * self.size[:2]
        return thing.at(x, y, z).at(*corner, 0, 90.0 * side)

    def put(self, thing: Thing, keep_clear_m: float = 0.0) -> Thing:
        """Add an object at its current place."""
        self.things.append(thing)
        self.taken.append(thing.bounds() + keep_clear_m * np.array([[-1, -1, 0], [1, 1, 0]]))
        return thing

    def try_to_put(self, place: Callable[[], Thing]) -> Thing | None:
        """Add an object at the first of its random places that is free and in the room, if any."""
        for _ in range(_TRIES):
            there = place()
            low, high = there.bounds()
            inside = (low > -1e-6).all() and (high < self.size + 1e-6).all()
            if inside and not any((low < other[1]).all() and (high > other[0]).all()
                                  for other in self.taken):
                return self.put(there)
        return None

    def try_on_wall(self, side: int, make: Callable[[np.random.Generator], Thing], low: tuple,
                    high: tuple) -> Thing | None:
        """Add an object on a wall between two places, if it fits."""
        thing = make(self.rng)

        def place() -> Thing:
            share, y, z = self.rng.uniform(low, high)
            return self.on_wall(thing, side, share * self.length(side), y, z)
        return self.try_to_put(place)

    def try_on_floor(self, thing: Thing) -> None:
        """Add an object anywhere on the floor, if it fits."""
        self.try_to_put(lambda: thing.at(*self.rng.uniform(0, self.size[:2]), 0,
                                         self.rng.uniform(0, 360)))

    def put_on(self, below: Thing, often: tuple[int, int] = ALWAYS) -> None:
        """Add objects on top of another, away from its edges, if there is space."""
        low, high = below.bounds()
        for _ in range(self.count(often)):
            thing = furniture.on_table(self.rng)

            def place(thing: Thing = thing) -> Thing:
                x, y = low[:2] + self.rng.uniform(0.25, 0.75, 2) * (high - low)[:2]
                return thing.at(x, y, high[2], self.rng.uniform(-90, 90))
            self.try_to_put(place)

    def put_along(self, side: int, objects: tuple) -> None:
        """
        Add objects along a wall where there is space.

        Each is given by how often it stands there (a probability or a range of numbers), what it
        is, and two places between which it is put: share of the length, distance, height.
        """
        for often, *what in objects:
            for _ in range(self.count(often)):
                self.try_on_wall(side, *what)

    def build(self, side: int, hole: furniture.Opening | None = None, hole_x: float = 0.0,
              door: tuple[float, ...] = ()) -> None:
        """Add a wall, and its skirting boards except at a door between two values of x."""
        wall = furniture.wall(self.length(side), self.size[2], hole, hole_x)
        ends = [0.0, *door, self.length(side)]
        board = furniture.skirting(list(zip(ends[::2], ends[1::2], strict=True)),
                                       *self.skirting)
        self.things += [self.on_wall(wall, side, 0), self.on_wall(board, side, 0)]

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
    room.build(side)
    room.put(room.on_wall(furniture.sofa(rng), side, rng.uniform(0.42, 0.58) * room.length(side),
                          rng.uniform(0.03, 0.15)))
    room.put_along(side, (
        ((1, 4), furniture.picture, (0.2, 0, 1.4), (0.8, 0, 1.8)),
        (0.7, furniture.floor_lamp, (0.02, 0.25, 0), (0.98, 0.35, 0))))
    small = room.try_on_wall(side, partial(furniture.table, low=(0.4, 0.38, 0.4),
                                           high=(0.5, 0.5, 0.55)),
                             (0.02, 0.3, 0), (0.98, 0.4, 0))
    if small is not None:
        room.put_on(small)


def _television_wall(room: _Room, side: int) -> None:
    """Add a bench with a television above, a shelf with books, and a plant."""
    rng = room.rng
    room.build(side)
    share = rng.uniform(0.35, 0.65)
    bench = room.put(room.on_wall(furniture.television_bench(rng), side,
                                  share * room.length(side), 0.03))
    room.try_on_wall(side, furniture.television, (share, 0, 1.2), (share, 0, 1.35))
    room.put_on(bench, (0, 3))
    room.put_along(side, (
        (ALWAYS, furniture.bookshelf, (0, 0.03, 0), (1, 0.05, 0)),
        (ALWAYS, furniture.plant, (0, 0.3, 0), (1, 0.45, 0)),
        (ALWAYS, furniture.picture, (0.1, 0, 1.4), (0.9, 0, 1.8))))


def _window_wall(room: _Room, side: int) -> None:
    """Add a window with sill, curtains and the objects below it."""
    rng = room.rng
    half, low, top = rng.uniform([0.5, 0.65, 0.2], [0.95, 0.95, 0.45])
    hole = furniture.Opening(half, low, room.size[2] - top)
    x = rng.uniform(0.4, 0.6) * room.length(side)
    room.build(side, hole, x)
    for often, make in ((ALWAYS, furniture.window), (ALWAYS, furniture.curtains),
                        (0.5, furniture.radiator)):
        if room.count(often):
            room.put(room.on_wall(make(rng, hole), side, x))
    if room.count(0.6):
        room.put(room.on_wall(furniture.vase(rng), side, x + rng.uniform(-0.3, 0.3), 0.03,
                              low + 0.005))


def _door_wall(room: _Room, side: int) -> None:
    """Add a door, a cupboard and pictures."""
    x = room.rng.uniform(0.25, 0.75) * room.length(side)
    door = furniture.door(room.rng)
    room.build(side, door=tuple(door.bounds()[:, 0] + x))
    room.put(room.on_wall(door, side, x), keep_clear_m=0.5)
    low, high = (((0.7, 0.35, 0.75), (1.3, 0.45, 1.1)) if room.count(0.5)
                 else ((0.6, 0.4, 1.7), (1.0, 0.6, 2.1)))
    cupboard = room.try_on_wall(side, partial(furniture.cupboard, low=low, high=high),
                                (0, 0.03, 0), (1, 0.05, 0))
    if cupboard is not None and cupboard.bounds()[1, 2] < 1.2:
        room.put_on(cupboard)
    room.put_along(side, (((1, 3), furniture.picture, (0.1, 0, 1.4), (0.9, 0, 1.8)),))


def _middle(room: _Room, side: int) -> None:
    """Add free-standing objects: coffee table on a rug at the sofa, chairs, a plant, a lamp."""
    rng = room.rng
    ahead = rng.uniform(1.55, 1.75)
    x = rng.uniform(0.45, 0.55) * room.length(side)
    half = rng.uniform([0.8, 0.55], [1.2, 0.85])
    thick = rng.uniform(0.008, 0.012)
    rug = block([*-half, 0], [*half, thick]) if rng.uniform() < 0.7 else drum(half[1], 0, thick)
    room.things.append(room.on_wall(rug.at(0, 0, 0, rng.uniform(-8, 8)), side, x, ahead))
    coffee = furniture.table(rng, (0.8, 0.45, 0.35), (1.3, 0.7, 0.48))
    coffee = room.put(room.on_wall(coffee.at(0, 0, 0, rng.uniform(-6, 6)), side, x, ahead, thick))
    room.put_on(coffee, (1, 4))
    room.try_on_floor(furniture.lounge_chair(rng) if rng.uniform() < 0.6
                      else furniture.sofa(rng, 0.75, 0.95))
    for often, make in (((1, 4), furniture.chair), (0.5, furniture.pouf),
                        (0.5, furniture.plant)):
        for _ in range(room.count(often)):
            room.try_on_floor(make(rng))
    if room.count(0.4):
        place = rng.uniform(0.3, 0.7, 2) * room.size[:2]
        room.put(furniture.pendant_lamp(rng).at(*place, room.size[2]))
