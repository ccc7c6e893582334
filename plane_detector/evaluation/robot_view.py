# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The moving picture of the README: a rendered drive to the edge of a loading dock.

    python -m plane_detector.evaluation.robot_view docs/figures/robot_view.webp

Each image passes through the whole pipeline with the noise of a stereo camera. The drawing shows
what the node would publish: ground, obstacles, drops and plane labels.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from plane_detector import drawing
from plane_detector.config import Config, ScaleConfig
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rendering import Scene, camera_rotation, render
from plane_detector.evaluation.scenes.terrain import FAR_M, Course, Kind
from plane_detector.geometry.projection import depth_to_points
from plane_detector.pipeline import PlaneDetector
from plane_detector.types import CameraIntrinsics, Detection

CAMERA = CameraIntrinsics(370.0, 370.0, 219.5, 164.5, 440, 330)
HEIGHT_M, PITCH_DEG, EDGE_M, STOP_M = 0.75, -24.0, 5.0, 3.4
IMAGES, IMAGE_MS, LAST_MS = 40, 140, 1800
NOISE = 0.001  # 1/m: of 1/depth, as of a stereo camera
GREEN, ORANGE, RED = (40, 175, 75), (245, 130, 30), (225, 20, 30)
LEGEND = (('ground', GREEN), ('obstacle', ORANGE), ('drop', RED))
_SHARE, _TILE_M, _JOINT_M = 0.55, 0.5, 0.012


def loading_dock() -> Course:
    """Return a hall with boxes, one of them 8 cm high, whose floor ends 0.9 m above the yard."""
    course = Course(1.9)
    course.on(EDGE_M, 0.0, Kind.FLOOR)
    course.on(EDGE_M, -0.9, Kind.LOWER)
    course.on(FAR_M, -0.9, Kind.LOWER)
    course.add_walls()
    course.add_box(-1.1, 2.6, np.array([0.5, 0.5, 0.45]), yaw_deg=15.0)
    course.add_box(1.15, 3.5, np.array([0.6, 0.4, 0.3]), yaw_deg=-20.0)
    course.add_box(0.5, 2.2, np.array([0.25, 0.3, 0.08]), yaw_deg=30.0)
    course.add_box(-0.9, 4.4, np.array([0.35, 0.35, 0.2]), yaw_deg=-10.0)
    return course


def pose(share: float) -> tuple[np.ndarray, np.ndarray]:
    """Return rotation and position of the camera after this share of the drive."""
    swing = np.sin(2 * np.pi * share)
    return (camera_rotation(6 * swing, PITCH_DEG, np.sin(4 * np.pi * share)),
            np.array([0.25 * swing, STOP_M * share, HEIGHT_M]))


def drive(images: int = IMAGES) -> Iterator[tuple[np.ndarray, Detection]]:
    """Yield image (H, W, 3) uint8 and detection, from the start to the edge of the dock."""
    course, rng = loading_dock(), np.random.default_rng(9000)
    detector = PlaneDetector(Config(scale=ScaleConfig(camera_height=HEIGHT_M)),
                             lambda rgb: depth_m)
    for share in np.linspace(0, 1, images).tolist():
        rotation, position = pose(share)
        scene = render(course.rectangles, rotation, position, CAMERA, rng)
        fine = render(course.rectangles, rotation, position, _doubled(CAMERA), rng)
        rgb = cv2.resize(_painted(fine, course, rotation, position), (CAMERA.width, CAMERA.height),
                         interpolation=cv2.INTER_AREA)
        depth_m = with_disparity_noise(scene.depth_m, NOISE, rng)
        yield rgb, detector.detect(rgb, CAMERA, gravity_camera=scene.gravity_camera,
                                   stamp_s=share * images * IMAGE_MS / 1e3)


def _doubled(camera: CameraIntrinsics) -> CameraIntrinsics:
    return CameraIntrinsics(2 * camera.fx, 2 * camera.fy, 2 * camera.cx + 0.5,
                            2 * camera.cy + 0.5, 2 * camera.width, 2 * camera.height)


def _painted(scene: Scene, course: Course, rotation: np.ndarray, position: np.ndarray
             ) -> np.ndarray:
    """Return the image: tiles on level ground, wood for the boxes, plain walls, lit from above."""
    x, y, _ = np.moveaxis(depth_to_points(scene.depth_m, scene.intrinsics) @ rotation.T + position,
                          -1, 0)
    up = np.abs(scene.planes[:, :3] @ rotation.T)
    light = (0.62 + 0.3 * up[:, 2] + 0.14 * up[:, 0])[scene.labels]
    kinds = np.array(course.kinds)[scene.rectangles[scene.labels]]
    of_box = scene.rectangles[scene.labels] >= len(course.rectangles) - 24
    colours = np.select([of_box[..., None], (kinds == Kind.OBSTACLE)[..., None],
                         (kinds == Kind.LOWER)[..., None]],
                        [(176, 132, 84), (206, 200, 188), (120, 122, 128)], (168, 160, 150))
    is_joint = ~of_box & (kinds != Kind.OBSTACLE) & (
        (abs(x % _TILE_M) < _JOINT_M) | (abs(y % _TILE_M) < _JOINT_M))
    rgb = colours * (light * np.where(is_joint, 0.75, 1.0))[..., None]
    return np.clip(np.nan_to_num(rgb), 0, 255).astype(np.uint8)


def drawn(rgb: np.ndarray, found: Detection) -> np.ndarray:
    """Return the image with ground, obstacles, drops and the labels of the planes."""
    result = rgb.copy()
    for mask, colour in ((found.ground, GREEN), (found.obstacles, ORANGE)):
        result[mask] = (1 - _SHARE) * rgb[mask] + _SHARE * np.array(colour)
    for point_m in found.drops_m:
        u, v = (CAMERA.fx * point_m[0] / point_m[2] + CAMERA.cx,
                CAMERA.fy * point_m[1] / point_m[2] + CAMERA.cy)
        cv2.circle(result, (round(u), round(v)), 3, RED, -1, cv2.LINE_AA)
    drawing.draw_numbers(result, drawing.label_places(
        np.append(found.planes.labels, 0)[found.labels]))
    return result


def framed(rgb: np.ndarray, found: Detection) -> np.ndarray:
    """Return image and drawing side by side, above a legend of the colours."""
    panels = drawing.figure([('camera', rgb), ('plane_detector', drawn(rgb, found))])
    bar = np.full((30, panels.shape[1], 3), 255, np.uint8)
    left = rgb.shape[1] + 14
    for name, colour in LEGEND:
        cv2.rectangle(bar, (left, 6), (left + 18, 22), colour, -1)
        cv2.putText(bar, name, (left + 24, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1,
                    cv2.LINE_AA)
        left += 120
    return np.vstack([panels, bar])


def main(path: Path) -> None:
    """Write the moving picture."""
    from PIL import Image
    first, *others = [Image.fromarray(framed(rgb, found)) for rgb, found in drive()]
    first.save(path, save_all=True, append_images=others, loop=0, quality=62, method=6,
               duration=[IMAGE_MS] * len(others) + [LAST_MS])
    print(f'{path}: {path.stat().st_size / 1e6:.2f} MB')


if __name__ == '__main__':
    main(Path(sys.argv[1]))
