# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""True classes of pixels, from rendered scenes or measured depth, and shares of correct ones."""

from __future__ import annotations

import cv2
import numpy as np

from plane_detector.evaluation.scenes.rendering import Scene
from plane_detector.types import CameraIntrinsics, Detection, PlaneClass

# Accepted classes of a pixel: walls for upright surfaces, by the visible side for level ones.
UP, DOWN, UPRIGHT, NEITHER, UNKNOWN = 0, 1, 2, 3, -1
RIGHT = {UP: (PlaneClass.FLOOR, PlaneClass.OTHER_HORIZONTAL, PlaneClass.STEP),
         DOWN: (PlaneClass.CEILING, PlaneClass.OTHER_HORIZONTAL), UPRIGHT: (PlaneClass.WALL,)}
NAMED = (PlaneClass.FLOOR, PlaneClass.CEILING, PlaneClass.WALL, PlaneClass.OTHER_HORIZONTAL,
         PlaneClass.STEP, PlaneClass.RAMP)
# chosen: twice the error of gravity in the data, and a bound that slopes certainly exceed.
LEVEL_DEG, SLOPE_DEG = 10.0, 20.0
_WINDOW_PX, _LEAST_FILLED = 21, 0.9
# chosen: the noise of a Kinect over such a window, 1/m.
_MOST_RESIDUAL = 0.004


def side(normals: np.ndarray, down: np.ndarray) -> np.ndarray:
    """Return UP, DOWN, UPRIGHT, NEITHER or, between them, UNKNOWN of normals (..., 3)."""
    off_level_deg = np.degrees(np.arccos(np.clip(np.abs(normals @ down), 0, 1)))
    kinds = np.full(off_level_deg.shape, UNKNOWN)
    is_up = normals @ down < 0
    kinds[(off_level_deg < LEVEL_DEG) & is_up] = UP
    kinds[(off_level_deg < LEVEL_DEG) & ~is_up] = DOWN
    kinds[off_level_deg > 90 - LEVEL_DEG] = UPRIGHT
    kinds[(off_level_deg > SLOPE_DEG) & (off_level_deg < 90 - SLOPE_DEG)] = NEITHER
    return kinds


def classes_of_planes(scene: Scene) -> np.ndarray:
    """Return the true class of each pixel of a rendered scene, (H, W)."""
    kinds = np.append(side(scene.planes[:, :3], scene.gravity_camera), UNKNOWN)
    return kinds[scene.labels]


def classes_of_depth(depth_m: np.ndarray, intrinsics: CameraIntrinsics,
                     down: np.ndarray) -> np.ndarray:
    """
    Return what each pixel of measured depth is, (H, W), by the plane through its surroundings.

    1/z is affine in the pixel on a plane: least squares over a window, by box filters. UNKNOWN
    where much is missing or the window is not flat.
    """
    known = np.isfinite(depth_m)
    inverse = np.where(known, 1 / np.where(known, depth_m, 1), 0).astype(np.float64)
    v, u = np.indices(depth_m.shape).astype(np.float64)
    u, v = u - intrinsics.cx, v - intrinsics.cy

    def mean(image: np.ndarray) -> np.ndarray:
        return cv2.boxFilter(image * known, -1, (_WINDOW_PX, _WINDOW_PX))
    basis = (u, v, np.ones_like(u))
    left = np.stack([np.stack([mean(a * b) for a in basis], -1) for b in basis], -2)
    right = np.stack([mean(inverse * a) for a in basis], -1)
    filled = mean(np.ones_like(u))
    enough = filled > _LEAST_FILLED
    fits = np.zeros(right.shape)
    fits[enough] = np.linalg.solve(left[enough], right[enough][..., None])[..., 0]
    squares = mean(inverse**2) - (fits * right).sum(axis=-1)
    flat = enough & (squares < _MOST_RESIDUAL**2 * filled)
    a, b, c = np.moveaxis(fits, -1, 0)
    normals = -np.stack([a * intrinsics.fx, b * intrinsics.fy, c], -1)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    return np.where(flat, side(normals, down), UNKNOWN)


def class_shares(found: Detection, truth: np.ndarray, judged: np.ndarray | None = None
                 ) -> tuple[float, float]:
    """
    Return the share of true floors, walls and level surfaces that have the right class, and wrong.

    A class other than the correct ones is wrong, also on surfaces that are neither; no class is
    not wrong.
    """
    classes = np.append(found.planes.classes, PlaneClass.UNKNOWN)[found.labels]
    names = [np.isin(truth, (UP, DOWN, UPRIGHT))]
    right = np.zeros(truth.shape, bool)
    for kind, allowed in RIGHT.items():
        right |= (truth == kind) & np.isin(classes, allowed)
    known = (truth != UNKNOWN) if judged is None else (truth != UNKNOWN) & (judged >= 0)
    wrong = known & np.isin(classes, NAMED) & ~right
    total = np.count_nonzero(names[0] & known)
    return ((float(np.count_nonzero(right & known) / total), float(wrong.sum() / total))
            if total else (float('nan'), float('nan')))
