# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Effects of current sensors on large flat surfaces, in compact form: one scene and one error each.

- low stereo: a camera 6 to 16 cm above the floor. Stereo matches windows, so a pixel samples a
  neighbouring ray, as do its neighbours in the window; on a floor at grazing incidence this is the
  noise.
- albedo: time of flight over surfaces that reflect .05 to .9 of the light. The noise falls with
  the amplitude (Foix et al. 2011): a dark carpet has ten times that of a white wall.
- filtered: depth that a driver or a phone has smoothed and upsampled. It is smooth from pixel to
  pixel and wanders over the image.
- terraces: a bowed tray from above in stereo, rounded to millimetres, with less noise than that.
- bowed: table tops that bow by 2 to 5 mm.
- mesh: a table top of mesh or bars through which the floor is visible: each ray hits one of the
  two, or a pixel mixes them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from plane_detector.evaluation.scenes.rendering import (
    VGA,
    Scene,
    box,
    camera_rotation,
    rectangle,
    render,
)
from plane_detector.evaluation.scenes.rooms import random_room
from plane_detector.evaluation.scenes.sensors import (
    STEREO_BASELINE_M,
    lens_error,
    rounded,
    smooth_field,
)
from plane_detector.geometry.projection import depth_to_points
from plane_detector.types import CameraIntrinsics

PHONE = CameraIntrinsics(213.0, 213.0, 127.5, 95.5, 256, 192)
HALF = CameraIntrinsics(262.5, 262.5, 159.5, 119.5, 320, 240)
Case = Callable[[np.random.Generator], tuple[Scene, np.ndarray]]


def low_stereo(rng: np.random.Generator) -> tuple[Scene, np.ndarray]:
    """Return a floor with upright boxes before a wall, seen from 6 to 16 cm above the floor."""
    faces = [rectangle([-20, -1, 0], [40, 0, 0], [0, 40, 0]),
             rectangle([-20, rng.uniform(2.0, 3.5), 0], [40, 0, 0], [0, 0, 10])]
    for _ in range(rng.integers(3, 6)):
        size = rng.uniform([0.2, 0.2, 0.2], [0.6, 0.5, 0.8])
        place = np.array([rng.uniform(-0.8, 0.8), rng.uniform(0.9, 1.8), size[2] / 2])
        faces += box(place, size, rng.uniform(-40, 40))
    scene = render(faces, camera_rotation(rng.uniform(-10, 10), rng.uniform(-8, 2), 0),
                   np.array([0, 0, rng.uniform(0.06, 0.16)]), VGA, rng)
    return scene, matched(scene, rng, lateral_px=rng.uniform(0.4, 0.6))


def matched(scene: Scene, rng: np.random.Generator, lateral_px: float = 0.0,
            error_px: float = 0.03) -> np.ndarray:
    """Return depth by stereo: errors of place and of disparity, alike over a matching window."""
    v, u = np.indices(scene.depth_m.shape).astype(np.float32)
    shift_u, shift_v = (lateral_px * smooth_field(v.shape, 1.2, rng) for _ in range(2))
    seen_m = cv2.remap(scene.depth_m, (u + shift_u).astype(np.float32),
                       (v + shift_v).astype(np.float32), cv2.INTER_NEAREST,
                       borderMode=cv2.BORDER_REPLICATE)
    pixel = 1 / (scene.intrinsics.fx * STEREO_BASELINE_M)
    # Between rows and columns: the surface continues as its plane does.
    plane = scene.planes[scene.labels]
    ray_u = (u + shift_u - scene.intrinsics.cx) / scene.intrinsics.fx
    ray_v = (v + shift_v - scene.intrinsics.cy) / scene.intrinsics.fy
    disparity = -(plane[..., 0] * ray_u + plane[..., 1] * ray_v + plane[..., 2]) / plane[..., 3]
    disparity = np.where(np.isfinite(seen_m) & (scene.labels >= 0), disparity, np.nan)
    for blur_px in (2.0, 6.0, 20.0):
        disparity += error_px * pixel * smooth_field(v.shape, blur_px, rng)
    return rounded(np.where(disparity > 0.1, 1 / disparity, np.nan), 1e3)


def albedo(rng: np.random.Generator) -> tuple[Scene, np.ndarray]:
    """Return a room in time of flight, each surface of its own albedo, one of them a carpet."""
    scene = random_room(rng)
    reflected = rng.uniform(0.1, 0.9, len(scene.planes))
    largest = np.bincount(scene.labels[scene.labels >= 0]).argsort()[::-1]
    reflected[largest[0]], reflected[largest[1]] = 0.05, 0.9
    depth_m = scene.depth_m.astype(np.float64)
    sigma_m = 0.0005 * (1 + 0.4 * depth_m**2) * 0.9 / reflected[scene.labels]
    noise = 0.8 * rng.standard_normal(depth_m.shape) + 0.6 * smooth_field(depth_m.shape, 4.0, rng)
    return scene, (depth_m + sigma_m * noise + lens_error(depth_m.shape, 0.002)).astype(np.float32)


def filtered(rng: np.random.Generator) -> tuple[Scene, np.ndarray]:
    """Return a room in depth of a phone: smooth over a few pixels, wandering over the image."""
    scene = random_room(rng, PHONE)
    depth_m = scene.depth_m.astype(np.float64)
    error = sum(share * smooth_field(depth_m.shape, blur_px, rng)
                for blur_px, share in ((6.0, 0.0004), (16.0, 0.0010), (40.0, 0.0022)))
    return scene, (depth_m * (1 + error * depth_m)).astype(np.float32)


def terraces(rng: np.random.Generator) -> tuple[Scene, np.ndarray]:
    """Return a bowed tray from above in stereo, rounded to millimetres."""
    scene = _table(rng, rng.uniform(0.45, 0.6))
    return scene, matched_depth(bowed(scene, rng.uniform(0.003, 0.005)), scene.intrinsics, rng,
                                0.01)


def bowed_surface(rng: np.random.Generator) -> tuple[Scene, np.ndarray]:
    """Return a table top that bows by 2 to 5 mm, in stereo."""
    scene = _table(rng, rng.uniform(0.4, 0.7))
    return scene, matched_depth(bowed(scene, rng.uniform(0.002, 0.005)), scene.intrinsics, rng,
                                0.015)


def matched_depth(depth_m: np.ndarray, intrinsics: CameraIntrinsics, rng: np.random.Generator,
                  error_px: float) -> np.ndarray:
    """Return depth by stereo with errors of disparity alone, in millimetres."""
    pixel = 1 / (intrinsics.fx * STEREO_BASELINE_M)
    disparity = 1 / depth_m.astype(np.float64)
    for blur_px in (1.5, 4.0):
        disparity += error_px * pixel * smooth_field(depth_m.shape, blur_px, rng)
    return rounded(1 / disparity, 1e3)


def bowed(scene: Scene, bow_m: float) -> np.ndarray:
    """Return exact depth in which the largest plane bows by so much over half its longer side."""
    label = np.bincount(scene.labels[scene.labels >= 0]).argmax()
    plane, at = scene.planes[label], scene.labels == label
    points_m = depth_to_points(scene.depth_m, scene.intrinsics)[at].astype(np.float64)
    from_middle = points_m - points_m.mean(axis=0)
    # The variance along a side is a twelfth of its square.
    half_m = (3 * np.linalg.eigvalsh(np.cov(from_middle.T))[-1]) ** 0.5
    off_m = bow_m * (1 - (from_middle**2).sum(axis=1) / half_m**2)
    depth_m = scene.depth_m.astype(np.float64)
    depth_m[at] *= 1 - off_m / plane[3]
    return depth_m.astype(np.float32)


def _table(rng: np.random.Generator, height_m: float) -> Scene:
    """Return a tray or table top that fills most of the image, with a few boxes, from above."""
    half, pitch_deg = rng.uniform([0.4, 0.3], [0.5, 0.4]) * height_m, rng.uniform(-90, -70)
    faces = box([0, 0, -0.02], [*(2 * half), 0.04], rng.uniform(-10, 10))
    faces += [rectangle([-9, -9, -0.3], [18, 0, 0], [0, 18, 0])]
    for _ in range(rng.integers(1, 4)):
        size = rng.uniform(0.03, 0.08, 3) * height_m
        faces += box([*(rng.uniform(-0.6, 0.6, 2) * half), size[2] / 2], size, rng.uniform(0, 90))
    position = np.array([0, -height_m / np.tan(np.radians(-pitch_deg)), height_m])
    return render(faces, camera_rotation(0, pitch_deg, rng.uniform(-8, 8)), position, VGA, rng)


def mesh(rng: np.random.Generator) -> tuple[Scene, np.ndarray]:
    """
    Return a table top or deck of mesh or of bars above a floor, in stereo or time of flight.

    10 to 50 % of it is open, and its pitch is a third of a pixel to a dozen pixels; in half of the
    scenes each pixel mixes what its neighbours see. Pixels behind it have no label.
    """
    camera = VGA if rng.random() < 0.5 else HALF
    top_m, away_m, pitch_deg = rng.uniform([0.05, 0.7, -85], [0.9, 1.2, -45])
    side_m, bars = rng.uniform([0.9, 0.7], [1.6, 1.2]), rng.random() < 0.5
    pitch_m = rng.uniform(*((0.6, 12.0) if bars else (0.3, 8.0))) * away_m / camera.fx
    open_share = rng.uniform(0.1, 0.5)
    part = open_share if bars else open_share**0.5

    def is_solid(along_u: np.ndarray, along_v: np.ndarray) -> np.ndarray:
        is_open = along_v * side_m[1] / pitch_m % 1 < part
        return ~is_open if bars else ~(is_open & (along_u * side_m[0] / pitch_m % 1 < part))
    pitch = np.radians(-pitch_deg)
    centre = np.array([0, away_m * np.cos(pitch), top_m])
    corner = centre - [*(side_m / 2), 0]
    faces = [rectangle([-9, -9, 0], [18, 0, 0], [0, 18, 0]),
             rectangle(corner, [side_m[0], 0, 0], [0, side_m[1], 0], is_solid)]
    view = (camera_rotation(rng.uniform(-20, 20), pitch_deg, rng.uniform(-90, 90)),
            np.array([0, 0, top_m + away_m * np.sin(pitch)]), camera)
    scene = render(faces, *view, rng)
    closed = render([replace(faces[1], mask=None)], *view, np.random.default_rng(0))
    is_behind = (closed.labels == 0) & (scene.rectangles[scene.labels] == 0)
    scene = replace(scene, labels=np.where(is_behind, np.int32(-1), scene.labels))
    depth_m = scene.depth_m
    if rng.random() < 0.5:
        depth_m = 1 / cv2.GaussianBlur(1 / depth_m, (0, 0), rng.uniform(0.3, 0.5))
    if rng.random() < 0.5:
        return scene, matched_depth(depth_m, camera, rng, 0.05)
    sigma_m = 0.002 + 0.001 * depth_m.astype(np.float64)**2
    return scene, (depth_m + sigma_m * rng.standard_normal(depth_m.shape)).astype(np.float32)


SENSOR_CASES: dict[str, Case] = {
    'low stereo': low_stereo, 'albedo': albedo, 'filtered': filtered, 'terraces': terraces,
    'bowed': bowed_surface, 'mesh': mesh}
