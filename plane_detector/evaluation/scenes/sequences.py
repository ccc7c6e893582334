# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Short sequences of rendered rooms in which nothing, a box or the camera moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from plane_detector.evaluation.scenes.rooms import (
    VGA,
    Rectangle,
    Scene,
    box,
    camera_rotation,
    furnished_room,
    render,
)

RATE_HZ = 30.0
FRAMES = 12
_GREY_NOISE = 3.0
_BOX_SIZE_M, _BOX_DISTANCE_M = (0.5, 0.5, 0.8), 1.8
_MARGIN_PX, _MOVED_DEPTH = 9, 1e-4


@dataclass(frozen=True)
class Motion:
    """A motion and its speed: the camera turns (degrees per second), or a box moves (m/s)."""

    name: str
    pan_deg_s: float = 0.0
    box_m_s: float = 0.0


MOTIONS = (Motion('nothing moves'), Motion('a box moves 1 m/s', box_m_s=1.0),
           Motion('a box moves 0.05 m/s', box_m_s=0.05),
           Motion('camera turns 0.6 deg/s', pan_deg_s=0.6),
           Motion('camera turns 6 deg/s', pan_deg_s=6.0))


@dataclass(frozen=True)
class View:
    """
    An image of a sequence.

    Attributes
    ----------
    scene : Scene
        Its ``rgb`` has independent sensor noise.
    moved : (H, W) bool
        Pixels that showed another surface or depth in an earlier image, with a margin.

    """

    scene: Scene
    moved: np.ndarray


def sequence(seed: int, motion: Motion) -> list[View]:
    """Return the images of a room, the newest last."""
    rng = np.random.default_rng(seed)
    room, rotation, position = furnished_room(rng)
    palette = rng.uniform(60, 220, (len(room) + 6, 3)).astype(np.float32)
    scenes = []
    for index in range(FRAMES):
        time_s = (index - FRAMES / 2) / RATE_HZ
        turned = rotation_about_up(motion.pan_deg_s * time_s) @ rotation
        moving = _box_at(rotation, position, motion.box_m_s * time_s) if motion.box_m_s else []
        if index == 0 or motion.pan_deg_s or motion.box_m_s:
            scene = render(room + moving, turned, position, VGA, rng)
        scenes.append(replace(scene, rgb=_seen(scene, palette, rng)))
    return _with_moved(scenes)


def rotation_about_up(yaw_deg: float) -> np.ndarray:
    """Return the rotation (3, 3) of the world about its z axis."""
    return camera_rotation(yaw_deg, 0, 0) @ camera_rotation(0, 0, 0).T


def _box_at(rotation: np.ndarray, position: np.ndarray, along_m: float) -> list[Rectangle]:
    """Return a box on the floor in front of the camera, shifted to its right."""
    right, _, ahead = rotation.T
    centre = position + _BOX_DISTANCE_M * ahead + along_m * right
    centre[2] = _BOX_SIZE_M[2] / 2
    return box(centre, np.array(_BOX_SIZE_M), 20.0)


def _seen(scene: Scene, palette: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the image, with the same colour of a surface in all images, and with sensor noise."""
    colours = palette[np.append(scene.rectangles, 0)]
    noise = rng.normal(0, _GREY_NOISE, (*scene.labels.shape, 3)).astype(np.float32)
    return np.clip(colours[scene.labels] + noise, 0, 255).astype(np.uint8)


def _with_moved(scenes: Sequence[Scene]) -> list[View]:
    """Return each image with the pixels at which something has moved so far."""
    views, moved = [], np.zeros(scenes[0].labels.shape, np.uint8)
    for before, scene in zip([scenes[0], *scenes], scenes, strict=False):
        ratio = scene.depth_m / before.depth_m
        moved |= ((_surfaces(scene) != _surfaces(before)) | (abs(ratio - 1) > _MOVED_DEPTH)
                  ).view(np.uint8)
        wide = cv2.dilate(moved, np.ones((_MARGIN_PX, _MARGIN_PX), np.uint8))
        views.append(View(scene, wide.view(bool)))
    return views


def _surfaces(scene: Scene) -> np.ndarray:
    """Return the rectangle visible in each pixel, -1 for none."""
    return np.append(scene.rectangles, -1)[scene.labels]
