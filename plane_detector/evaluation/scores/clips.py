# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Sequences of real images with depth and the true direction of gravity; turned cameras.

The direction is that of the level surfaces in the measured depth. Where poses are known, it is one
direction in their world frame, from all images, which agree within 2 degrees; otherwise that of
each image.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from plane_detector.evaluation.datasets import read_frame
from plane_detector.types import CameraIntrinsics

_GRAVITY = json.loads(Path(__file__).with_name('gravity.json').read_text())

# Directions in the frame of a camera that is turned about its axis by a quarter turn.
QUARTER_TURN = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])


@dataclass(frozen=True)
class Shot:
    """An image of a camera, and which way is down."""

    rgb: np.ndarray  # (H, W, 3) uint8
    depth_m: np.ndarray  # (H, W) float32, NaN where not measured
    intrinsics: CameraIntrinsics
    down: np.ndarray  # (3,) float64, in the optical frame
    stamp_s: float

    def turned(self, quarters: int) -> Shot:
        """Return the view of a camera that is turned about its axis by quarter turns."""
        shot = self
        for _ in range(quarters % 4):
            camera = shot.intrinsics
            shot = replace(
                shot, rgb=np.ascontiguousarray(np.rot90(shot.rgb)),
                depth_m=np.ascontiguousarray(np.rot90(shot.depth_m)),
                down=QUARTER_TURN @ shot.down,
                intrinsics=CameraIntrinsics(camera.fy, camera.fx, camera.cy,
                                            camera.width - 1 - camera.cx, camera.height,
                                            camera.width))
        return shot


def clip(data: Path, name: str, step: int, count: int) -> Sequence[Shot]:
    """Return every ``step``-th image of a set with a known direction of gravity."""
    return _clip(data, name, step, count)


@lru_cache(maxsize=4)
def _clip(data: Path, name: str, step: int, count: int) -> tuple[Shot, ...]:
    poses, shots = _poses(data / name), []
    period_s = 1 / 30 if name.startswith('videos') else 1 / 3
    for k, path in enumerate(sorted((data / name).glob('*_depth.png'))):
        frame = path.name.removesuffix('_depth.png')
        known = frame in poses if name in _GRAVITY else f'{name}/{frame}' in _GRAVITY
        if k % step or not known or len(shots) == count:
            continue
        down = (poses[frame][:, :3].T @ _GRAVITY[name] if name in _GRAVITY
                else np.array(_GRAVITY[f'{name}/{frame}']))
        one = read_frame(path)
        shots.append(Shot(one.rgb, one.depth_m, one.intrinsics, down / np.linalg.norm(down),
                          k * period_s))
    return tuple(shots)


def _poses(folder: Path) -> dict[str, np.ndarray]:
    """Return the pose of each image, camera to world (3, 4)."""
    if (folder / 'poses.txt').is_file():
        lines = [line.split() for line in (folder / 'poses.txt').read_text().splitlines()]
        return {name: np.array(numbers, float).reshape(3, 4) for name, *numbers in filter(
            None, lines)}
    return {path.name.removesuffix('_pose.txt'): np.loadtxt(path)[:3]
            for path in folder.glob('*_pose.txt')}
