# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Report of the demo on an image: figure, cloud and table as files, numbers on the screen."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from plane_detector import drawing
from plane_detector.directions.drawing import draw_directions
from plane_detector.directions.finder import CameraImage, find_in_image
from plane_detector.directions.vanishing import SceneDirections
from plane_detector.planes.classification import PlaneClass
from plane_detector.segmentation.baselines import ransac_alone
from plane_detector.tools.demo.photographs import Photograph
from plane_detector.tools.demo.session import Received
from plane_detector.tools.ply import write_ply
from plane_detector.tools.show import plane_lines
from plane_detector.types import CameraIntrinsics

# By class: name and RGB.
COLOURS = {kind: (name, drawing.PALETTE[k]) for kind, name, k in (
    (PlaneClass.FLOOR, 'green', 1), (PlaneClass.CEILING, 'yellow', 3),
    (PlaneClass.WALL, 'blue', 2), (PlaneClass.OTHER_HORIZONTAL, 'orange', 6),
    (PlaneClass.OTHER, 'violet', 4), (PlaneClass.RAMP, 'cyan', 5),
    (PlaneClass.STEP, 'orange', 6))}


@dataclass(frozen=True)
class Outcome:
    """A photograph, the name of its files, the source of its depth, and what the node found."""

    photograph: Photograph
    name: str
    depth_title: str
    received: Received

    @cached_property
    def directions(self) -> SceneDirections:
        """The vertical and the axes by the lines of the image alone."""
        image = CameraImage(self.photograph.rgb, self.photograph.intrinsics)
        return find_in_image(image).directions


def write_files(outcome: Outcome, folder: Path) -> list[Path]:
    """Write figure, cloud and table; return their paths."""
    paths = [folder / f'{outcome.name}.{suffix}' for suffix in ('png', 'ply', 'csv')]
    cv2.imwrite(str(paths[0]), cv2.cvtColor(_figure(outcome), cv2.COLOR_RGB2BGR))
    points, rgb = outcome.received.points, outcome.photograph.rgb
    xyz_m = np.stack([points['x'], points['y'], points['z']], axis=-1)
    write_ply(paths[1], xyz_m, drawing.tint(rgb, points['label']), points['label'],
              in_metres=outcome.received.unit == 'm')
    _write_csv(paths[2], outcome.received.planes)
    return paths


def print_outcome(outcome: Outcome, paths: list[Path]) -> None:
    """Print the table of planes, the time of a frame and the files."""
    photograph, received = outcome.photograph, outcome.received
    size = photograph.intrinsics
    print(f'\n{outcome.name}: {size.width} x {size.height}, fx {size.fx:.0f} px, '
          f'{photograph.calibration}')
    print('\n'.join(f'  {line}' for line in plane_lines(received.planes)))
    if not legend(received.planes):
        reason = outcome.directions.refusal
        print('  (the direction of gravity is not known: no floor, no walls'
              f'{f"; {reason}" if reason else ""})')
    if received.unit != 'm':
        print('  (lengths in an unknown unit)')
    print(f'  {received.frame_ms:.0f} ms from the image to the planes, all through the topics of '
          'one process')
    if photograph.remark:
        print(f'  {photograph.remark}')
    print('  ' + ', '.join(str(path) for path in paths))


def _figure(outcome: Outcome) -> np.ndarray:
    """Return image, depth, planes of RANSAC alone, and planes by class."""
    received, rgb = outcome.received, outcome.photograph.rgb
    classes = legend(received.planes)
    near, far = drawing.depth_range(received.depth_m)
    alone = ransac_alone(received.depth_m) + 1
    return drawing.figure([
        _directions_panel(outcome.photograph, outcome.directions),
        (f'{outcome.depth_title}, red {near:.1f} {received.unit} to blue {far:.1f} '
         f'{received.unit}', drawing.colour_depth(received.depth_m)),
        (f'RANSAC alone: {len(np.unique(alone[alone > 0]))} planes', drawing.overlay(rgb, alone)),
        (f'{len(received.planes)} planes{f": {classes}" if classes else ""}',
         drawing.overlay(rgb, received.points['label'], class_colours(received.planes))),
    ])


def _directions_panel(photograph: Photograph, found: SceneDirections) -> tuple[str, np.ndarray]:
    """Return the image with its lines, and the vertical estimated from them as in the node."""
    axes = found.pairs[:1].reshape(-1, 3)
    drawn = draw_directions(photograph.rgb, photograph.intrinsics, found.gravity_camera, axes)
    if found.gravity_camera is None:
        return 'image', drawn
    level = ', horizontal axes red and green' if len(axes) else ''
    horizon = ', horizon yellow' if _sees_horizon(photograph.intrinsics, found) else ''
    return f'image: vertical blue{level}{horizon}', drawn


def _sees_horizon(camera: CameraIntrinsics, found: SceneDirections) -> bool:
    """Return whether corners of the image lie on both sides of the horizon."""
    corners = np.array([((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0)
                        for u in (0, camera.width) for v in (0, camera.height)])
    side = corners @ found.gravity_camera
    return bool(side.min() < 0 < side.max())


def _write_csv(path: Path, planes: np.ndarray) -> None:
    with open(path, 'w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file)
        writer.writerow(planes.dtype.names)
        for plane in planes:
            writer.writerow([f'{value:.6g}' if isinstance(value, np.floating) else value
                             for value in plane])


def class_colours(planes: np.ndarray) -> np.ndarray:
    """Return the RGB (L, 3) of labels from 0 on: of its class, or its own without a class."""
    colours = drawing.label_colours(np.arange(planes['label'].max(initial=0) + 1))
    for plane in planes:
        if plane['class'] in COLOURS:
            colours[plane['label']] = COLOURS[plane['class']][1]
    return colours


def legend(planes: np.ndarray) -> str:
    """Return the classes in the scene with their colours; empty if none is known."""
    return ', '.join(f'{kind.name.lower().replace("_", " ")} {colour}'
                     for kind, (colour, _) in COLOURS.items() if (planes['class'] == kind).any())
