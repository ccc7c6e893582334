# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Report of the demo on an image: figure, cloud and table as files, numbers on the screen."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from plane_detector import drawing
from plane_detector.directions.drawing import draw_directions
from plane_detector.directions.finder import CameraImage, find_in_image
from plane_detector.directions.vanishing import SceneDirections
from plane_detector.tools.demo.node_client import Received, Timing
from plane_detector.tools.demo.photographs import Photograph
from plane_detector.tools.demo.scene_table import class_colours, legend, scene_table
from plane_detector.tools.demo.sensor_comparison import JudgedPlane, depth_error, judge_planes
from plane_detector.tools.ply import write_ply
from plane_detector.types import CameraIntrinsics

_ROWS_SHOWN = 12
# A plane is right if this share of its pixels is on one real plane within this angle.
# smaller.
_PURE, _RIGHT_DEG = 0.8, 10.0


@dataclass(frozen=True)
class Outcome:
    """
    An image and the results of the node.

    Attributes
    ----------
    photograph : Photograph
    source : str
        Source of the depth: a network, or the depth topic.
    received : Received
        Messages of the node.
    timing : Timing
        For many frames of this image.
    ransac_labels : (H, W) integer
        Label of each pixel by RANSAC without clustering, 0 for none.

    """

    photograph: Photograph
    source: str
    received: Received
    timing: Timing
    ransac_labels: np.ndarray

    @property
    def name(self) -> str:
        """Name of the result files."""
        suffix = '_depth_topic' if self.source == 'depth topic' else ''
        return self.photograph.name + suffix

    @property
    def depth_title(self) -> str:
        """Readable source of the depth."""
        return ('measured depth' if self.source == 'depth topic'
                else f'depth from {self.source}')

    @property
    def unit(self) -> str:
        """Unit of lengths: metres only if the node's diagnostics name their source."""
        scales = [status.get('scale', '') for status in self.timing.statuses] or ['']
        return 'm' if scales[-1] not in ('', 'relative') else 'units'


def write_files(outcome: Outcome, folder: Path) -> list[Path]:
    """Write figure, cloud and table; return their paths."""
    paths = [folder / f'{outcome.name}.{suffix}' for suffix in ('png', 'ply', 'csv')]
    cv2.imwrite(str(paths[0]), cv2.cvtColor(_figure(outcome), cv2.COLOR_RGB2BGR))
    points, rgb = outcome.received.points, outcome.photograph.rgb
    xyz_m = np.stack([points['x'], points['y'], points['z']], axis=-1)
    write_ply(paths[1], xyz_m, drawing.tint(rgb, points['label']), points['label'],
              in_metres=outcome.unit == 'm')
    _write_csv(paths[2], outcome.received.planes)
    return paths


def print_outcome(outcome: Outcome, paths: list[Path]) -> None:
    """Print table, rate, time of each stage and the errors against the true depth."""
    photograph, timing = outcome.photograph, outcome.timing
    size = photograph.intrinsics
    print(f'\n{outcome.name}: {size.width} x {size.height}, fx {size.fx:.0f} px, '
          f'{photograph.calibration}')
    print(scene_table(outcome.received.planes, outcome.unit))
    _print_directions(photograph)
    stages = ', '.join(f'{stage} {ms:.1f}' for stage, ms in timing.stage_ms().items())
    print(f'  {timing.rate_hz:.1f} frames per second through the topics; ms per frame in the '
          f'node: {stages or "not reported"}')
    if photograph.true_depth_m is not None:
        _print_truth(outcome)
    if photograph.remark:
        print(f'  {photograph.remark}')
    print('  ' + ', '.join(str(path) for path in paths))


def _figure(outcome: Outcome) -> np.ndarray:
    """Return image, depth, planes of RANSAC alone, and planes by class."""
    received = outcome.received
    classes = legend(received.planes)
    near, far = drawing.depth_range(received.depth_m)
    alone = len(np.unique(outcome.ransac_labels[outcome.ransac_labels > 0]))
    return drawing.figure([
        _directions_panel(outcome.photograph),
        (f'{outcome.depth_title}, red {near:.1f} {outcome.unit} to blue {far:.1f} '
         f'{outcome.unit}', drawing.colour_depth(received.depth_m)),
        (f'RANSAC alone: {alone} planes',
         drawing.overlay(outcome.photograph.rgb, outcome.ransac_labels)),
        (f'{len(received.planes)} planes{f": {classes}" if classes else ""}',
         drawing.overlay(outcome.photograph.rgb, received.points['label'],
                         class_colours(received.planes))),
    ])


def _directions_panel(photograph: Photograph) -> tuple[str, np.ndarray]:
    """Return the image with its lines, and the vertical estimated from them as in the node."""
    found = _directions(photograph)
    axes = np.concatenate([np.zeros((0, 3)), *(pair.axes for pair in found.pairs[:1])])
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


def _directions(photograph: Photograph) -> SceneDirections:
    return find_in_image(CameraImage(photograph.rgb, photograph.intrinsics),
                         np.random.default_rng(0)).directions


def _print_directions(photograph: Photograph) -> None:
    found = _directions(photograph)
    if found.refusal:
        print(f'  the lines of the image do not give the vertical: {found.refusal}')
    elif found.pair_refusal:
        print(f'  the lines of the image give the vertical, but no horizontal axes: '
              f'{found.pair_refusal}')


def _write_csv(path: Path, planes: np.ndarray) -> None:
    with open(path, 'w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file)
        writer.writerow(planes.dtype.names)
        for plane in planes:
            writer.writerow([f'{value:.6g}' if isinstance(value, np.floating) else value
                             for value in plane])


def _print_truth(outcome: Outcome) -> None:
    if outcome.unit != 'm':
        print('  the depth has no known scale: it is not compared with the truth in metres')
        return
    received, photograph = outcome.received, outcome.photograph
    relative, ratio = depth_error(received.depth_m, photograph.true_depth_m)
    print(f'  against the true depth: relative error of the depth {relative:.3f}, its median '
          f'{ratio:.2f} times the true one')
    judged = _judged(received, photograph)
    columns = ('label', 'distance cm', 'normal deg', 'd cm', 'purity %')
    print('  ' + ''.join(f'{column:>12}' for column in columns))
    for one in judged[:_ROWS_SHOWN]:
        print(f'  {received.planes["label"][one.index]:12d}{100 * one.distance_m:12.1f}'
              f'{one.normal_error_deg:12.1f}{100 * one.offset_error_m:12.1f}'
              f'{100 * one.purity:12.0f}')
    _print_verdict(judged, received.planes)
    print('  (distance: median from the true points of its pixels; normal and d: against the '
          'best plane\n  through these points; purity: share of them within max(3 cm, 1.5 % of '
          'z) of that plane)')


def _print_verdict(judged: list[JudgedPlane], planes: np.ndarray) -> None:
    """Print which planes are right."""
    right = [one for one in judged if one.purity >= _PURE and one.normal_error_deg <= _RIGHT_DEG]
    wrong = [one for one in judged if one not in right]
    share = sum(one.pixels for one in right) / max(sum(one.pixels for one in judged), 1)
    named = [', '.join(str(planes['label'][one.index]) for one in some[:_ROWS_SHOWN]) or 'none'
             for some in (right, wrong)]
    print(f'  right (one real plane, angle to it at most {_RIGHT_DEG:g} degrees): '
          f'{named[0]}; wrong: {named[1]}\n'
          f'  ({len(right)} of {len(judged)} planes, {share:.0%} of their pixels)')


def _judged(received: Received, photograph: Photograph) -> list[JudgedPlane]:
    planes, labels = received.planes, received.points['label']
    index_of = np.full(max(labels.max(), planes['label'].max(initial=0)) + 1, -1)
    index_of[planes['label']] = np.arange(len(planes))
    coefficients = np.column_stack([planes[name] for name in (
        'normal_x', 'normal_y', 'normal_z', 'd')])
    return judge_planes(index_of[labels], coefficients, photograph.true_depth_m,
                        photograph.intrinsics, np.random.default_rng(0))
