# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Demo: sends photographs to the node over its topics, and draws the planes that it publishes.

Without --images it uses two photographs that are included in libraries. The first one, a workshop,
is similar to the training images of indoor networks. It has a measured depth, with which the demo
runs a second time, as with a depth camera. The second photograph is outdoors, where these networks
do badly.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from plane_detector.dependencies import explained_imports
from plane_detector.ending import quiet_interrupt, run_program, until_signal

with quiet_interrupt(), explained_imports('numba', installed=['scipy']):
    import cv2
    import numpy as np

    from plane_detector import drawing
    from plane_detector.config import DepthConfig
    from plane_detector.depth.networks import NETWORKS, resolve
    from plane_detector.directions.finder import CameraImage, find_in_image
    from plane_detector.directions.vanishing import SceneDirections
    from plane_detector.geometry.disparity import to_disparity
    from plane_detector.ros.spinning import CannotRunError
    from plane_detector.segmentation.baselines import ransac_alone
    from plane_detector.tools.demo.directions import draw_directions
    from plane_detector.tools.demo.photographs import (
        Lens,
        Photograph,
        folder_images,
        library_images,
    )
    from plane_detector.tools.demo.session import Received, Session
    from plane_detector.tools.files import csv_row, depth_panel, write_ply
    from plane_detector.tools.show import plane_lines
    from plane_detector.types import CameraIntrinsics, PlaneClass

# By class: name of the colour, and its place in the palette.
COLOURS = {PlaneClass.FLOOR: ('green', 1), PlaneClass.CEILING: ('yellow', 3),
           PlaneClass.WALL: ('blue', 2), PlaneClass.OTHER_HORIZONTAL: ('orange', 6),
           PlaneClass.OTHER: ('violet', 4), PlaneClass.RAMP: ('cyan', 5),
           PlaneClass.STEP: ('orange', 6)}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demo; return the exit code."""
    options = _parser().parse_args(arguments)
    return run_program('demo', lambda: until_signal(lambda: _run(options)), CannotRunError)


def _run(options: argparse.Namespace) -> int:
    lens = Lens(options.fx, options.fy, options.cx, options.cy, options.fov)
    if options.images and options.without_network:
        raise ValueError('images of a folder have no measured depth: they need the network')
    if lens != Lens() and not options.images:
        raise ValueError('a calibration or a field of view is for your own images: name their '
                         'folder by --images (make demo IMAGES=...)')
    photographs = folder_images(options.images, lens) if options.images else library_images()
    options.output.mkdir(parents=True, exist_ok=True)
    if not options.without_network:
        network = _network(options)
        _show(photographs, network, f'depth from {Path(network["depth.model"]).stem}', '',
              options.output)
    measured = [one for one in photographs if one.true_depth_m is not None]
    if measured:
        _show(measured, {'depth.source': 'topic'}, 'measured depth', '_depth_topic',
              options.output)
    print(f'\nThe images are in {options.output}/')
    return 0


def _network(options: argparse.Namespace) -> dict[str, str]:
    """Return the parameters for the depth network, and make sure that its file is cached."""
    model, path = options.model, Path(options.model).expanduser()
    if model not in ('auto', *NETWORKS):
        if not path.is_file():
            raise FileNotFoundError(f'--model {model} is neither a file nor one of auto, '
                                    f'{", ".join(NETWORKS)}')
        if not options.model_output:
            raise ValueError('--model-output must state the output of a network file')
        return {'depth.model': str(path.absolute()), 'depth.output': options.model_output}
    network, path, reason, _ = resolve(DepthConfig(model=model))
    print(f'Depth network: {reason}.\n  {path}\n  {network.output}, {network.summary}')
    return {'depth.model': network.name}


def _show(photographs: Sequence[Photograph], parameters: Mapping[str, str], depth_title: str,
          suffix: str, folder: Path) -> None:
    """Send each photograph to a node with these parameters; draw and print what it finds."""
    with Session(parameters) as session:
        for photograph in photographs:
            received, name = session.process(photograph), photograph.name + suffix
            directions = _directions_of(photograph, received)
            paths = [folder / f'{name}.{kind}' for kind in ('png', 'ply', 'csv')]
            figure = _figure(photograph, directions, depth_title, received)
            cv2.imwrite(str(paths[0]), cv2.cvtColor(figure, cv2.COLOR_RGB2BGR))
            _write_tables(paths[1], paths[2], photograph, received)
            _print(name, photograph, directions, received)
            print('  ' + ', '.join(map(str, paths)))


def _directions_of(photograph: Photograph, received: Received) -> SceneDirections:
    """Return the directions as the node finds them, by lines and depth, in an image seen again."""
    disparity = to_disparity(received.depth_m) if received.unit == 'm' else None
    image = CameraImage(photograph.rgb, photograph.intrinsics, disparity=disparity)
    return find_in_image(image, before=find_in_image(image)).directions


def _write_tables(ply: Path, table: Path, photograph: Photograph, received: Received) -> None:
    """Write the labelled cloud and the rows of the planes."""
    points, labels = received.points, received.points['label']
    xyz_m = np.stack([points['x'], points['y'], points['z']], axis=-1)
    write_ply(ply, xyz_m, drawing.tint(photograph.rgb, labels), labels,
              in_metres=received.unit == 'm')
    with open(table, 'w', newline='', encoding='utf-8') as file:
        csv.writer(file).writerows([received.planes.dtype.names,
                                    *map(csv_row, received.planes)])


def _print(name: str, photograph: Photograph, directions: SceneDirections,
           received: Received) -> None:
    """Print the table of planes and the time of a frame."""
    size = photograph.intrinsics
    print(f'\n{name}: {size.width} x {size.height}, fx {size.fx:.0f} px, '
          f'{photograph.calibration}')
    print('\n'.join(f'  {line}' for line in plane_lines(received.planes)))
    if not _legend(received.planes):
        print('  (the direction of gravity is not known: no floor, no walls'
              f'{f"; {directions.refusal}" if directions.refusal else ""})')
    if received.unit != 'm':
        print('  (lengths in an unknown unit)')
    print(f'  {received.frame_ms:.0f} ms from the image to the planes, all through the topics of '
          'one process')
    if photograph.remark:
        print(f'  {photograph.remark}')


def _figure(photograph: Photograph, directions: SceneDirections, depth_title: str,
            received: Received) -> np.ndarray:
    """Return image, depth, planes of RANSAC alone, and planes by class."""
    planes, rgb, classes = received.planes, photograph.rgb, _legend(received.planes)
    alone = ransac_alone(received.depth_m) + 1
    colours = drawing.label_colours(np.arange(planes['label'].max(initial=0) + 1))
    for plane in planes:
        if plane['class'] in COLOURS:
            colours[plane['label']] = drawing.PALETTE[COLOURS[plane['class']][1]]
    return drawing.figure([
        _directions_panel(photograph, directions),
        depth_panel(depth_title, received.depth_m, received.unit),
        (f'RANSAC alone: {len(np.unique(alone[alone > 0]))} planes', drawing.overlay(rgb, alone)),
        (f'{len(planes)} planes{f": {classes}" if classes else ""}',
         drawing.overlay(rgb, received.points['label'], colours)),
    ])


def _directions_panel(photograph: Photograph, found: SceneDirections) -> tuple[str, np.ndarray]:
    """Return the image with the vertical, the axes and the horizon."""
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


def _legend(planes: np.ndarray) -> str:
    """Return the classes in the scene with their colours; empty if none is known."""
    return ', '.join(f'{kind.name.lower().replace("_", " ")} {colour}'
                     for kind, (colour, _) in COLOURS.items() if (planes['class'] == kind).any())


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--images', type=Path, help='folder of your own images')
    for name in ('fx', 'fy', 'cx', 'cy'):
        parser.add_argument(f'--{name}', type=float, help='calibration of these images, pixels')
    parser.add_argument('--fov', type=float,
                        help='horizontal field of view in degrees, instead of a calibration')
    parser.add_argument('--model', default='auto', metavar='NAME|FILE', help=(
        f'depth network: auto, {", ".join(NETWORKS)}, or an .onnx file (default: %(default)s)'))
    parser.add_argument('--model-output', choices=['metric_depth', 'disparity',
                                                   'relative_disparity'],
                        help='output of a network file')
    parser.add_argument('--without-network', action='store_true',
                        help='only process images with measured depth')
    parser.add_argument('--output', type=Path, default=Path('demo_output'),
                        help='folder of the results (default: %(default)s)')
    return parser


if __name__ == '__main__':
    sys.exit(main())
