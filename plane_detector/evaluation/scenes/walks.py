# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Walks of a camera through rendered rooms, and poses with the errors of odometry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from plane_detector.evaluation.scenes.rendering import (
    Rectangle,
    Scene,
    box,
    camera_rotation,
    rectangle,
    render,
)
from plane_detector.evaluation.scenes.surfaces import outside
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.types import CameraIntrinsics

QVGA = CameraIntrinsics(262.5, 262.5, 159.5, 119.5, 320, 240)


@dataclass(frozen=True)
class Walk:
    """Surfaces, those that go or move, and the true poses of the camera."""

    surfaces: tuple[Rectangle, ...]  # that stay
    poses: tuple[RigidTransform, ...]  # from the camera to the world, z up
    gone: tuple[Rectangle, ...] = ()  # present only in the first half
    people: tuple[tuple[Rectangle, ...], ...] = ()  # of each image; empty: none

    def scene(self, index: int, intrinsics: CameraIntrinsics, rng: np.random.Generator) -> Scene:
        """Render an image; ``rectangles`` count the surfaces, then those that go, then people."""
        visible = list(self.surfaces)
        # Far below, so that the numbers of the rectangles stay the same.
        away = [Rectangle(face.corner - [0, 0, 100], face.edge_u, face.edge_v)
                for face in self.gone]
        visible += self.gone if 2 * index < len(self.poses) else away
        visible += self.people[index] if self.people else ()
        pose = self.poses[index]
        return render(visible, pose.rotation, pose.translation_m, intrinsics, rng)


def walk(name: str, rng: np.random.Generator, images: int) -> Walk:
    """Return one of :data:`ROOMS` with a path of the camera through it."""
    return ROOMS[name](rng, images)


def look_around(size: np.ndarray, rng: np.random.Generator,
                images: int) -> tuple[RigidTransform, ...]:
    """Return poses that look across the room, all around once, and up and down meanwhile."""
    start_deg, ahead = rng.uniform(0, 360), rng.choice([-1, 1])
    poses = []
    for k, share in enumerate(np.linspace(0, 1, images).tolist()):
        yaw_deg = start_deg + ahead * 360 * share
        rotation = camera_rotation(yaw_deg, -15 + 12 * np.sin(6 * np.pi * share),
                                   2 * np.sin(2 * np.pi * share))
        back = -0.2 * size[:2] * rotation[:2, 2]
        poses.append(RigidTransform(rotation, np.append(back, 1.3 + 0.1 * np.sin(0.3 * k))))
    return tuple(poses)


def walls(size: np.ndarray) -> list[Rectangle]:
    """Return floor, ceiling and walls of a room about the origin."""
    return box([0, 0, size[2] / 2], size)


def _box_room(rng: np.random.Generator, images: int) -> Walk:
    size = rng.uniform([3.5, 4.0, 2.4], [5.0, 6.0, 2.9])
    faces = walls(size)
    for side in (-1, 1):  # a cupboard at a wall, a table away from the middle
        width, deep, high = rng.uniform([0.6, 0.35, 0.7], [1.4, 0.6, 1.9])
        faces += box([side * (size[0] - deep) / 2, rng.uniform(-0.3, 0.3) * size[1], high / 2],
                     [deep, width, high])
    faces += _table(rng, 0.0, 0.36 * size[1] * rng.choice([-1, 1]))
    return Walk(tuple(faces), look_around(size, rng, images))


def _table(rng: np.random.Generator, x: float, y: float) -> list[Rectangle]:
    width, deep, high = rng.uniform([0.8, 0.6, 0.68], [1.4, 0.8, 0.78])
    return box([x, y, high - 0.02], [width, deep, 0.04], rng.uniform(-10, 10))


def _doorway(rng: np.random.Generator, images: int) -> Walk:
    """A wall with a doorway, its leaf open 4 cm before a wall, and a picture 2 cm before one."""
    size = np.array([*rng.uniform([4.4, 4.4], [5.2, 5.2]), 2.5])
    x, y = size[:2] / 2
    faces = walls(size + [0, 4.0, 0])  # the other room is behind
    shift = np.array([0, 2.0, 0])
    faces = [Rectangle(face.corner + shift, face.edge_u, face.edge_v) for face in faces]
    left = rng.uniform(0.35, 0.5)
    width = 0.9 / size[0]
    faces.append(rectangle([-x, y, 0], [size[0], 0, 0], [0, 0, size[2]],
                           outside((left, -1), (left + width, 0.8))))
    faces += box([-x + 0.02 + 0.02, y - 0.9, 1.0], [0.04, 0.85, 2.0])  # the leaf
    faces += box([x - 0.01, rng.uniform(-0.8, 0.8), 1.5], [0.02, 0.9, 0.7])
    return Walk(tuple(faces), look_around(size, rng, images))


def _books(rng: np.random.Generator, images: int) -> Walk:
    """Tables with books 3 and 6 cm high on them."""
    size = rng.uniform([3.8, 4.0, 2.4], [4.6, 5.0, 2.7])
    faces = walls(size)
    for side in (-1, 1):
        y = side * 0.33 * size[1]
        faces += box([0, y, 0.71], [1.3, 0.75, 0.04])
        for x, high in ((-0.35, 0.03), (0.3, 0.06)):
            faces += box([x, y, 0.73 + high / 2], [0.32, 0.26, high], rng.uniform(-15, 15))
    return Walk(tuple(faces), look_around(size, rng, images))


def _steps(rng: np.random.Generator, images: int) -> Walk:
    """Three steps up to a podium, and a ramp."""
    size = rng.uniform([4.4, 4.6, 2.8], [5.2, 5.4, 3.2])
    x, y = size[:2] / 2
    rise = rng.uniform(0.12, 0.17)
    faces = walls(size)
    for k in range(3):  # treads across the far end
        near = y - 1.4 + 0.3 * k
        deep = 0.3 if k < 2 else y - near
        faces += [rectangle([-x, near, rise * k], [size[0], 0, 0], [0, 0, rise]),
                  rectangle([-x, near, rise * (k + 1)], [size[0], 0, 0], [0, deep, 0])]
    faces.append(rectangle([-0.6, -y + 1.5, 0], [1.2, 0, 0], [0, -1.5, 0.3]))
    return Walk(tuple(faces), look_around(size, rng, images))


def _panel(rng: np.random.Generator, images: int) -> Walk:
    """A thin panel that the camera walks around."""
    size = rng.uniform([4.8, 4.8, 2.4], [5.6, 5.6, 2.8])
    faces = walls(size) + box([0, 0, 0.8], [1.2, 0.03, 1.6], rng.uniform(0, 90))
    turn = np.linspace(0, 2 * np.pi, images) + rng.uniform(0, 2 * np.pi)
    poses = tuple(RigidTransform(
        camera_rotation(np.degrees(angle) + 90 + 25 * np.sin(3 * angle), -10, 0),
        np.array([1.75 * np.cos(angle), 1.75 * np.sin(angle), 1.2])) for angle in turn.tolist())
    return Walk(tuple(faces), poses)


def _crate(rng: np.random.Generator, images: int) -> Walk:
    """A crate that is present in the first half; both halves see the whole room."""
    size = rng.uniform([3.6, 4.0, 2.4], [4.4, 5.0, 2.7])
    crate = box([rng.choice([-1, 1]) * 0.33 * size[0], 0.2, 0.3], [0.6, 0.6, 0.6],
                rng.uniform(0, 40))
    half = look_around(size, rng, images // 2)
    return Walk((*walls(size), *_table(rng, 0.0, 0.36 * size[1])), half + half, tuple(crate))


def with_people(walked: Walk, rng: np.random.Generator) -> Walk:
    """Return a walk with two people who cross the view all the time."""
    people = []
    phases = rng.uniform(0, 1, 2)
    for k, pose in enumerate(walked.poses):
        faces: list[Rectangle] = []
        for number, phase in enumerate(phases.tolist()):
            across = 1.6 * np.sin(2 * np.pi * (k / 25 + phase))
            ahead = pose.rotation @ [across, 0, 1.2 + 0.3 * number]
            place = pose.translation_m + ahead
            faces += box([place[0], place[1], 0.85], [0.45, 0.25, 1.7], 13.0 * k)
        people.append(tuple(faces))
    return Walk(walked.surfaces, walked.poses, walked.gone, tuple(people))


def standing(walked: Walk, images: int) -> Walk:
    """Return a walk whose camera stays at its first pose."""
    return Walk(walked.surfaces, walked.poses[:1] * images)


ROOMS = {'box': _box_room, 'doorway': _doorway, 'books': _books, 'steps': _steps,
         'panel': _panel, 'crate': _crate}
HARD = ('doorway', 'books', 'steps', 'panel', 'crate')


def with_errors(poses: Sequence[RigidTransform], kind: str, rng: np.random.Generator
                ) -> list[RigidTransform]:
    """
    Return poses as from odometry, in its own frame.

    ``exact``; ``drift``: 10 cm and 2 degrees over the walk; ``jitter``: 1 cm and .3 degrees, new
    in each image; ``jump 10`` and ``jump 30``: a jump of 10 or 30 cm half-way.
    """
    direction, axis = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
    given = []
    for k, pose in enumerate(poses):
        share = k / max(len(poses) - 1, 1)
        shift_m, turn = np.zeros(3), np.zeros(3)
        if kind == 'drift':
            shift_m, turn = 0.1 * share * direction, np.radians(2.0) * share * axis
        elif kind == 'jitter':
            shift_m = rng.normal(0, 0.01 / np.sqrt(3), 3)
            turn = rng.normal(0, np.radians(0.3) / np.sqrt(3), 3)
        elif kind.startswith('jump') and 2 * k >= len(poses):
            shift_m = 0.01 * float(kind.split()[1]) * direction
        elif not kind.startswith('jump') and kind != 'exact':
            raise ValueError(f'there are no poses {kind!r}')
        rotation = cv2.Rodrigues(turn)[0]
        given.append(RigidTransform(rotation @ pose.rotation, pose.translation_m + shift_m))
    return given
