# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
A small scene whose planes are known exactly, and plain numpy readings of it.

The camera is not VGA, its pixels are not square and its principal point is off the centre. A wall
has a window and is cut in two by a pole; under it is a floor, before it stands a ball.
"""

from __future__ import annotations

import numpy as np
from ros_helpers import header

from plane_detector.config import NodeConfig
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.ros.outputs.frame import DetectedFrame
from plane_detector.types import (
    METRIC,
    CameraIntrinsics,
    Detection,
    GroundLack,
    GroundResult,
    Plane,
    PlaneClass,
    Planes,
    Shape,
    ShapeType,
)

CAMERA = CameraIntrinsics(80.0, 95.0, 30.5, 45.25, 110, 72)
WALL, FLOOR, BALL, NOTHING = 0, 1, 2, -1
TRACKS, CLASSES, MERGED = (7, 3), (PlaneClass.WALL, PlaneClass.FLOOR), (0, 4)
BALL_LABEL = 32768 + 5
MESSAGE_LABELS = {WALL: 7, FLOOR: 3, BALL: BALL_LABEL, NOTHING: 0}
EQUATIONS = {WALL: (np.array([-0.28, 0.0, -0.96]), 3.0), FLOOR: (np.array([0.0, -1.0, 0.0]), 0.6)}
TARGET = RigidTransform.from_quaternion((0.1, 0.2, 0.3, 0.9), (1.0, -2.0, 3.0))


def rays() -> np.ndarray:
    """Return the direction of each pixel with z = 1, (H, W, 3)."""
    v, u = np.indices((CAMERA.height, CAMERA.width))
    return np.stack([(u - 30.5) / 80.0, (v - 45.25) / 95.0, np.ones(u.shape)], axis=-1)


def depth_of(index: int) -> np.ndarray:
    """Return the depth of a plane at each pixel, infinite beyond its horizon."""
    normal, offset_m = EQUATIONS[index]
    towards = -(rays() @ normal)
    return np.where(towards > 1e-9, offset_m / np.where(towards > 1e-9, towards, 1.0), np.inf)


def depth_and_labels() -> tuple[np.ndarray, np.ndarray]:
    wall_m, floor_m = depth_of(WALL), depth_of(FLOOR)
    depth_m = np.minimum(wall_m, floor_m).astype(np.float32)
    labels = np.where(wall_m < floor_m, WALL, FLOOR).astype(np.int32)
    labels[8:20, 20:40], depth_m[8:20, 20:40] = NOTHING, 9.0     # the window
    labels[:, 80:84], depth_m[:, 80:84] = NOTHING, 0.8           # the pole
    labels[30:40, 50:60], depth_m[30:40, 50:60] = BALL, 1.5
    for row, value in enumerate((np.nan, np.inf, 0.0, -1.0)):
        depth_m[row, -1], labels[row, -1] = value, NOTHING
    depth_m.flags.writeable = False  # as views of messages are
    return depth_m, labels


def points() -> np.ndarray:
    """Return the point of each pixel in the frame of the camera, (H, W, 3), NaN without depth."""
    depth_m = depth_and_labels()[0].astype(float)
    valid = np.isfinite(depth_m) & (depth_m > 0)
    return np.where(valid, depth_m, np.nan)[..., None] * rays()


def plane(index: int) -> Plane:
    normal, offset_m = EQUATIONS[index]
    own_m = points()[depth_and_labels()[1] == index]
    return Plane(normal, offset_m, own_m.mean(axis=0), len(own_m), 0.003, 2.5, np.eye(4), 0.75,
                 plane_class=CLASSES[index], label=TRACKS[index], merged=MERGED[index])


def ground_result(labels: np.ndarray) -> GroundResult:
    """Return the floor; heights are numbers of pixels, and all but the ball is an obstacle."""
    numbers = np.arange(labels.size, dtype=np.float32).reshape(labels.shape)
    return GroundResult(
        GroundLack.NOTHING, labels == FLOOR, (labels != FLOOR) & (labels != BALL), numbers,
        numbers / 8,
        drops_m=np.array([[0.5, 1.0, 2.0], [0.6, 1.0, 2.0]]),
        drop_depths_m=np.array([0.25, np.nan]))


def detection(**changes) -> Detection:
    depth_m, labels = depth_and_labels()
    is_ball = labels == BALL
    ball = Shape(ShapeType.SPHERE, np.array([0.4, -0.1, 1.6]), np.zeros(3), 0.1, 0.0, 0.0, 100,
                 0.01, np.eye(4), 0.8, label=5)
    values = {'planes': Planes.of([plane(WALL), plane(FLOOR)]),
              'labels': np.where(is_ball, NOTHING, labels), 'disparity_noise': 0.0,
              'depth_m': depth_m, 'scale': METRIC, 'shapes': (ball,),
              'shape_labels': np.where(is_ball, 0, NOTHING),
              'ground_result': ground_result(labels), **changes}
    return Detection(**values)


def frame(found: Detection | None = None, to_target: RigidTransform | None = None,
          **settings) -> DetectedFrame:
    """Return the processed frame; `found` replaces its detection."""
    rgb = np.random.default_rng(2).integers(0, 256, (CAMERA.height, CAMERA.width, 3), np.uint8)
    rgb.flags.writeable = False
    if to_target is not None:
        settings['target_frame'] = 'map'
    found = found or detection()
    return DetectedFrame(found, CAMERA, to_target, 1.5, header=header(1.5), rgb=rgb,
                         settings=NodeConfig(**settings))
