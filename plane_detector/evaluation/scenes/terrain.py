# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Rendered terrain in front of a robot, with the truth of ground, obstacles and drops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import partial
from itertools import product

import numpy as np

from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rendering import (
    VGA,
    Rectangle,
    Scene,
    box,
    camera_rotation,
    rectangle,
    render,
)
from plane_detector.evaluation.scenes.surfaces import Revolution, bar, outside
from plane_detector.geometry.projection import depth_to_points

BEHIND_M, FAR_M, OUTDOORS_M = -3.0, 9.0, 12.0
# The quantisation of a Kinect: an eighth of a pixel at 580 pixels and 7.5 cm.
KINECT_STEP = 0.125 / (580 * 0.075)
TABLE_HEIGHT_M = 0.72


class Kind(IntEnum):
    """What a pixel shows."""

    NOTHING = -1
    FLOOR = 0
    RAMP = 1
    LANDING = 2
    LOWER = 3
    UPPER = 4
    OBSTACLE = 5


@dataclass(frozen=True)
class View:
    """Place and angles of the camera."""

    height_m: float  # over the floor at the start
    pitch_deg: float  # positive downwards
    roll_deg: float = 0.0
    yaw_deg: float = 0.0
    forward_m: float = 0.0  # along y

    def distance_m(self, below_axis_deg: float, farthest_m: float = 3.0) -> float:
        """Return where a ray below the optical axis meets the floor."""
        return min(farthest_m, self.height_m / np.tan(
            np.radians(np.clip(self.pitch_deg + below_axis_deg, 1.0, 89.0))))


def random_view(rng: np.random.Generator) -> View:
    """Return a camera as on robots: .3 to 1.5 m high, 5 to 40 degrees downwards, rolled."""
    return View(rng.uniform(0.3, 1.5), rng.uniform(5, 40), rng.uniform(-5, 5),
                rng.uniform(-10, 10))


@dataclass
class Course:
    """Surfaces under construction: the robot stands at the origin and looks along y."""

    half_width_m: float
    # y and z of the ground
    profile: list[tuple[float, float]] = field(default_factory=lambda: [(BEHIND_M, 0.0)])
    rectangles: list[Rectangle] = field(default_factory=list)
    kinds: list[Kind] = field(default_factory=list)
    curved: list[Revolution] = field(default_factory=list)
    # where the ground ends, from one point to another, and the depth of the drop
    edges: list[tuple[np.ndarray, np.ndarray, float]] = field(default_factory=list)
    # low x, high x, low y, high y of a part of the floor without depth
    patch: tuple[float, float, float, float] | None = None

    def on(self, y: float, z: float, kind: Kind) -> None:
        """Continue the ground to a point; straight down leaves an edge."""
        (y0, z0), w = self.profile[-1], self.half_width_m
        if y == y0 and z < z0:
            self.edges.append((np.array([-w, y, z0]), np.array([w, y, z0]), z0 - z))
        self.add([rectangle([-w, y0, z0], [2 * w, 0, 0], [0, y - y0, z - z0])], kind)
        self.profile.append((y, z))

    def add(self, rectangles: list[Rectangle], kind: Kind) -> None:
        """Add surfaces of one kind."""
        self.rectangles += rectangles
        self.kinds += [kind] * len(rectangles)

    def add_box(self, x: float, y: float, size: np.ndarray, z: float = 0.0,
                yaw_deg: float = 0.0) -> None:
        """Add an obstacle that stands on a height."""
        self.add(box(np.array([x, y, z + size[2] / 2]), size, yaw_deg), Kind.OBSTACLE)

    def add_walls(self) -> None:
        """Add walls on both sides and at the end."""
        w = self.half_width_m
        self.add([*(rectangle([x, BEHIND_M, -3], [0, FAR_M - BEHIND_M, 0], [0, 0, 6])
                    for x in (-w, w)), rectangle([-w, FAR_M, -3], [2 * w, 0, 0], [0, 0, 6])],
                 Kind.OBSTACLE)

    def ground_z(self, y: np.ndarray) -> np.ndarray:
        """Return the height of the ground at y."""
        ways, heights = np.array(self.profile).T
        return np.interp(y, ways, heights)


@dataclass(frozen=True)
class Terrain:
    """A rendered view with its truth."""

    scene: Scene
    kinds: np.ndarray  # (H, W) int8: a Kind for each pixel
    points_m: np.ndarray  # (H, W, 3) float32: in the world, its origin on the floor at the robot
    above_m: np.ndarray  # (H, W) float32: height over the ground below each point
    edges_m: np.ndarray  # (E, 3): points along all edges
    drops_m: np.ndarray  # (E,): depth of the drop there
    # (E,) bool: the camera sees the edge and looks over it, at something lower or at nothing, and
    # the robot reaches it without falling: the first step of descending stairs, not the next ones
    is_visible: np.ndarray
    to_world: np.ndarray  # (3, 3): rotation of the camera
    position_m: np.ndarray  # (3,): of the camera

    def in_world(self, points_m: np.ndarray) -> np.ndarray:
        """Return points (N, 3) of the camera frame in the world."""
        return points_m @ self.to_world.T + self.position_m


def flat(rng: np.random.Generator, start_m: float) -> Course:
    """Return a level floor, with walls or outdoors."""
    course = Course(rng.uniform(1.5, 4.0))
    if rng.random() < 0.3:
        course.half_width_m = OUTDOORS_M
    course.on(FAR_M, 0.0, Kind.FLOOR)
    if course.half_width_m < OUTDOORS_M:
        course.add_walls()
    return course


def clutter(rng: np.random.Generator, start_m: float) -> Course:
    """Return a floor with boxes from 3 cm, a table or a cable on it."""
    course = flat(rng, start_m)
    for _ in range(rng.integers(2, 6)):
        size = np.append(rng.uniform(0.1, 0.4, 2),
                         rng.choice([0.03, 0.06, 0.08, 0.1, 0.15, 0.2, 0.3, 0.6]))
        course.add_box(rng.uniform(-1.2, 1.2), start_m + rng.uniform(0, 2.0), size,
                       yaw_deg=rng.uniform(0, 90))
    if rng.random() < 0.5:
        x, y, thick = rng.uniform(-1, 1), start_m + rng.uniform(1.0, 2.0), 0.03
        course.add_box(x, y, np.array([1.2, 0.7, thick]), TABLE_HEIGHT_M - thick)
        for dx, dy in ((-0.55, -0.3), (0.55, -0.3), (-0.55, 0.3), (0.55, 0.3)):
            course.add_box(x + dx, y + dy, np.array([0.05, 0.05, TABLE_HEIGHT_M - thick]))
    else:
        radius, y = rng.uniform(0.004, 0.01), start_m + rng.uniform(0, 1.0)
        course.curved += bar((-1.5, y, radius), (1.5, y + 0.5, radius), radius).curved_pieces()
    return course


def doorstep(rng: np.random.Generator, start_m: float) -> Course:
    """Return a door with a sill of 2 cm, which a robot can drive over."""
    course, sill = Course(rng.uniform(1.5, 3.0)), start_m + 0.12
    for y, z in ((start_m, 0.0), (start_m, 0.02), (sill, 0.02), (sill, 0.0), (FAR_M, 0.0)):
        course.on(y, z, Kind.FLOOR)
    course.edges.clear()
    width = course.half_width_m - 0.5
    for side in (-1, 1):
        course.add_box(side * (0.5 + width / 2), (start_m + sill) / 2,
                       np.array([width, 0.12, 2.1]))
    course.add_walls()
    return course


def ramp(rng: np.random.Generator, start_m: float, sign: int) -> Course:
    """Return a ramp of 3 to 15 degrees and the level behind it."""
    angle = np.radians(rng.uniform(3, 15))
    course, length = Course(rng.uniform(0.8, 3.0)), rng.uniform(0.8, 3.0)
    rise, foot = sign * length * np.sin(angle), start_m + length * np.cos(angle)
    course.on(start_m, 0.0, Kind.FLOOR)
    course.on(foot, rise, Kind.RAMP)
    course.on(FAR_M, rise, Kind.LANDING)
    if rng.random() < 0.5 or sign < 0:
        course.add_walls()
        return course
    # It stands free on a wider floor.
    w, wide = course.half_width_m, 4.0
    for side in (-1, 1):
        course.add([rectangle([min(side * w, side * (w + wide)), BEHIND_M, 0], [wide, 0, 0],
                              [0, FAR_M - BEHIND_M, 0])], Kind.FLOOR)
        top = np.array([side * w, foot, rise])
        course.edges += [(np.array([side * w, start_m, 0.0]), top, rise),
                         (top, np.array([side * w, FAR_M, rise]), rise)]
        # The flanks in strips: a rectangle is all that can be rendered.
        course.add([*(rectangle([side * w, start_m + part * length * np.cos(angle), 0],
                                [0, 0.05 * length * np.cos(angle), 0],
                                [0, 0, (part + 0.05) * rise]) for part in np.arange(0, 1, 0.05)),
                    rectangle([side * w, foot, 0], [0, FAR_M - foot, 0], [0, 0, rise])],
                   Kind.OBSTACLE)
    return course


def kerb(rng: np.random.Generator, start_m: float, sign: int,
         height_m: float | None = None) -> Course:
    """Return a kerb of 5 to 20 cm, up or down."""
    height_m = height_m or float(rng.choice([0.05, 0.08, 0.1, 0.12, 0.15, 0.2]))
    course = Course(rng.choice([2.0, OUTDOORS_M]))
    course.on(start_m, 0.0, Kind.FLOOR)
    course.on(start_m, sign * height_m, Kind.OBSTACLE)
    course.on(FAR_M, sign * height_m, Kind.UPPER if sign > 0 else Kind.LOWER)
    if course.half_width_m < OUTDOORS_M:
        course.add_walls()
    return course


def stairs(rng: np.random.Generator, start_m: float, sign: int) -> Course:
    """Return stairs of 3 to 8 steps with a landing behind."""
    rise, run = sign * rng.uniform(0.14, 0.2), rng.uniform(0.25, 0.32)
    course, kind = Course(rng.uniform(0.7, 2.0)), Kind.UPPER if sign > 0 else Kind.LOWER
    course.on(start_m, 0.0, Kind.FLOOR)
    count = int(rng.integers(3, 9))
    for k in range(1, count + 1):
        course.on(start_m + (k - 1) * run, k * rise, Kind.OBSTACLE)
        course.on(FAR_M if k == count else start_m + k * run, k * rise, kind)
    course.add_walls()
    return course


def hole(rng: np.random.Generator, start_m: float) -> Course:
    """Return a floor with a hole of .2 to 1 m depth."""
    course, depth = flat(rng, start_m), rng.uniform(0.2, 1.0)
    x, wide, long = rng.uniform(-0.6, 0.2), rng.uniform(0.4, 1.0), rng.uniform(0.5, 1.0)
    low, high = np.array([x, start_m]), np.array([x + wide, start_m + long])
    w = course.half_width_m
    shares = [((corner - [-w, BEHIND_M]) / [2 * w, FAR_M - BEHIND_M]) for corner in (low, high)]
    course.rectangles[0] = replace(course.rectangles[0], mask=outside(*shares))
    (x, y), bottom, up = low, [*low, -depth], [0, 0, depth]
    course.add([rectangle(bottom, [wide, 0, 0], [0, long, 0])], Kind.LOWER)
    course.add([rectangle(bottom, [wide, 0, 0], up),
                rectangle([x, y + long, -depth], [wide, 0, 0], up),
                rectangle(bottom, [0, long, 0], up),
                rectangle([x + wide, y, -depth], [0, long, 0], up)], Kind.OBSTACLE)
    corners = [np.append(corner, 0.0) for corner in (
        low, (high[0], low[1]), high, (low[0], high[1]), low)]
    course.edges += [(a, b, depth) for a, b in zip(corners, corners[1:], strict=False)]
    return course


def patch(rng: np.random.Generator, start_m: float) -> Course:
    """Return a floor with a part that returns no depth, such as glass or a black mat."""
    course, x = flat(rng, start_m), rng.uniform(-0.8, 0.2)
    course.patch = (x, x + rng.uniform(0.3, 1.2), start_m, start_m + rng.uniform(0.3, 1.0))
    return course


def quay(rng: np.random.Generator, start_m: float) -> Course:
    """Return a floor that ends, with nothing in the range of the camera behind it."""
    course = Course(OUTDOORS_M)
    course.on(start_m, 0.0, Kind.FLOOR)
    course.edges.append((np.array([-OUTDOORS_M, start_m, 0.0]),
                         np.array([OUTDOORS_M, start_m, 0.0]), np.inf))
    return course


COURSES: dict[str, Callable[[np.random.Generator, float], Course]] = {
    'flat': flat, 'boxes, tables, cables': clutter, 'doorstep': doorstep,
    **{f'{make.__name__} {way}': partial(make, sign=sign) for make, (way, sign) in product(
        (ramp, kerb, stairs), (('up', 1), ('down', -1)))},
    'hole': hole, 'patch without depth': patch, 'quay': quay}


def terrain(name: str, rng: np.random.Generator) -> Terrain:
    """Return a random view of a kind of terrain."""
    view = random_view(rng)
    near_m, far_m = view.distance_m(26.0), view.distance_m(-18.0)
    start_m = near_m + max(0.25, rng.uniform(0.2, 0.8) * (far_m - near_m))
    return look(COURSES[name](rng, start_m), view, rng)


def look(course: Course, view: View, rng: np.random.Generator) -> Terrain:
    """Render a course from the robot."""
    rotation = camera_rotation(view.yaw_deg, -view.pitch_deg, view.roll_deg)
    position = np.array([0.0, view.forward_m, view.height_m])
    scene = render(course.rectangles, rotation, position, VGA, rng, course.curved)
    kinds = np.full(scene.labels.shape, Kind.OBSTACLE, np.int8)  # a cable has no label
    on_plane = scene.labels >= 0
    kinds[on_plane] = np.array(course.kinds, np.int8)[scene.rectangles[scene.labels[on_plane]]]
    points_m = depth_to_points(scene.depth_m, scene.intrinsics) @ rotation.T + position
    if course.patch:
        x, y, z = np.moveaxis(points_m, -1, 0)
        hidden = ((x > course.patch[0]) & (x < course.patch[1]) & (y > course.patch[2])
                  & (y < course.patch[3]) & (z < 0.01))
        scene = replace(scene, depth_m=np.where(hidden, np.float32(np.nan), scene.depth_m))
        points_m[hidden] = np.nan
    kinds[np.isnan(scene.depth_m)] = Kind.NOTHING
    above_m = (points_m[..., 2] - course.ground_z(points_m[..., 1])).astype(np.float32)
    edges_m, drops_m = _sampled(course.edges)
    return Terrain(scene, kinds, points_m.astype(np.float32), above_m, edges_m, drops_m,
                   _looked_over(edges_m, points_m, rotation, position), rotation, position)


def noisy(terrain: Terrain, noise: float | str, rng: np.random.Generator) -> np.ndarray:
    """Return the depth with disparity noise of this level (1/m), or quantised: ``kinect``."""
    depth_m = terrain.scene.depth_m
    if noise == 'kinect':
        disparity = 1.0 / with_disparity_noise(depth_m, 0.0008, rng)
        return (1.0 / (np.maximum(np.round(disparity / KINECT_STEP), 1) * KINECT_STEP)
                ).astype(np.float32)
    return with_disparity_noise(depth_m, noise, rng) if noise else depth_m


def _sampled(edges: list[tuple[np.ndarray, np.ndarray, float]]) -> tuple[np.ndarray, np.ndarray]:
    points, drops = [np.zeros((0, 3))], [np.zeros(0)]
    for start, end, drop in edges:
        count = max(int(np.linalg.norm(end - start) / 0.02), 2)
        part = np.linspace(0, 1, count)[:, None]
        points.append(start + part * (end - start))
        # The flank of a ramp is as high as the ramp is there.
        drops.append(np.where(abs(start[2] - end[2]) > 0, points[-1][:, 2], drop))
    return np.concatenate(points), np.concatenate(drops)


def _looked_over(edges_m: np.ndarray, points_m: np.ndarray, rotation: np.ndarray,
                 position: np.ndarray) -> np.ndarray:
    """Return the visible edge points with something lower, or nothing, just above them."""
    x, y, z = ((edges_m - position) @ rotation).T
    z = np.where(z > 0.05, z, np.nan)
    u, v = VGA.fx * x / z + VGA.cx, VGA.fy * y / z + VGA.cy
    inside = (u > 3) & (u < VGA.width - 4) & (v > 12) & (v < VGA.height - 5)
    inside &= edges_m[:, 2] > -0.01
    found = np.zeros(len(edges_m), bool)
    for k in np.flatnonzero(inside):
        column, row = round(u[k]), round(v[k])
        near = points_m[row:row + 4, column]
        beyond = points_m[row - 8:row - 2, column]
        is_edge = np.linalg.norm(near - edges_m[k], axis=1) < 0.03 + 0.02 * z[k]
        # Not finite: nothing is visible, so the view is free.
        is_lower = ~(beyond[:, 2] > edges_m[k, 2] - 0.08)
        found[k] = is_edge.any() and is_lower.all()
    return found
