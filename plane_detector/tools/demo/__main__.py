# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Demo: sends photographs to the node over its topics, and draws the planes that it publishes.

Without --images it uses a photograph of a workshop that is included in scikit-image: first with
the depth of a stereo camera, as with a depth camera, then with a depth network.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from plane_detector._runtime.dependencies import explained_imports, explanation
from plane_detector._runtime.ending import quiet_interrupt, run_program, until_signal

with quiet_interrupt(), explained_imports('numba', 'scipy'):
    import cv2
    import numpy as np

    from plane_detector import drawing
    from plane_detector.config import DepthConfig
    from plane_detector.depth.networks import NETWORKS, resolve
    from plane_detector.ros.spinning import CannotRunError
    from plane_detector.segmentation.baselines import ransac_alone
    from plane_detector.tools.demo.photographs import (
        WORKSHOP_GRAVITY,
        Lens,
        Photograph,
        own_images,
        workshop,
    )
    from plane_detector.tools.demo.session import Received, Session
    from plane_detector.tools.files import csv_row, depth_panel, write_ply
    from plane_detector.tools.show import table_lines

_FASTDEPTH_IS = 'for floors and large walls of rooms'
# The files of the previous run, which the next run replaces.
_WRITTEN = '.written_by_the_demo'


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demo; return the exit code."""
    options = _parser().parse_args(arguments)
    return run_program('demo', lambda: until_signal(lambda: _run(options)), CannotRunError)


def _run(options: argparse.Namespace) -> int:
    lens = Lens(options.fx, options.fy, options.cx, options.cy, options.fov)
    if options.images and options.without_network:
        raise ValueError('your own images have no measured depth, so they need the network')
    if not options.images and (lens != Lens() or options.mounting != 'any'):
        raise ValueError('a calibration, a field of view or a mounting applies only to your own '
                         'images: name an image or a folder by --images (make demo IMAGES=...)')
    if options.model not in ('auto', *NETWORKS):
        if not Path(options.model).expanduser().is_file():
            raise FileNotFoundError(f'--model {options.model} is neither a file nor one of auto, '
                                    f'{", ".join(NETWORKS)}')
        if not options.model_output:
            raise ValueError('--model-output must state the kind of output of a network file')
    photographs = own_images(options.images, lens) if options.images else [workshop()]
    options.output.mkdir(parents=True, exist_ok=True)
    _remove_earlier(options.output)
    measured = [one for one in photographs if one.true_depth_m is not None]
    if measured:
        print('With measured depth, as from a depth camera:')
        _show(measured, {'depth.source': 'topic'}, 'measured depth', '_measured_depth',
              options.output)
        _write_bag(options.output / 'example_bag', measured[0])
    if not options.without_network:
        network = {**_network(options), 'directions.mounting': options.mounting}
        if not options.images:
            network['scale.gravity'] = WORKSHOP_GRAVITY
            print('  The direction of gravity is given, as a robot gets it from TF or an IMU.')
        name = Path(network['depth.model']).stem
        _show(photographs, network, f'depth from {name}', f'_{name}', options.output)
    print(f'\nThe images are in {options.output}/')
    return 0


def _write_bag(folder: Path, photograph: Photograph) -> None:
    """Write a bag for the tutorial, unless it exists or the library for bags is not installed."""
    if folder.exists():
        print(f'\n{folder} is from an earlier run')
        return
    try:
        from plane_detector.tools.demo.example_bag import write_example_bag
    except ModuleNotFoundError as error:
        if error.name != 'rosbags':
            raise
        print(f'\nNo bag for the tutorial: {explanation(error)}')
        return
    write_example_bag(folder, photograph)
    print(f'\n{folder}: the same as a bag from a depth camera, for docs/tutorial.md')


def _remove_earlier(folder: Path) -> None:
    """Remove the files that an earlier run wrote into the folder, and nothing else."""
    listed = folder / _WRITTEN
    for name in listed.read_text('utf-8').splitlines() if listed.is_file() else ():
        (folder / Path(name).name).unlink(missing_ok=True)
    listed.unlink(missing_ok=True)


def _network(options: argparse.Namespace) -> dict[str, Any]:
    """Return the parameters for the depth network, and make sure that its file is cached."""
    if options.model not in ('auto', *NETWORKS):
        path = Path(options.model).expanduser().absolute()
        return {'depth.model': str(path), 'depth.output': options.model_output}
    network, path, reason, _ = resolve(DepthConfig(model=options.model))
    print(f'\nThrough a depth network: {reason}.\n  {path}\n  {network.output}, {network.summary}')
    if network.name == 'fastdepth':
        print(f'  It is the smallest one, {_FASTDEPTH_IS}; its metres are coarse.\n'
              '  Better networks: ros2 run plane_detector fetch, in a clone .venv/bin/python -m '
              'plane_detector.tools.fetch.')
    return {'depth.model': network.name}


def _show(photographs: Sequence[Photograph], parameters: Mapping[str, Any], depth_title: str,
          suffix: str, folder: Path) -> None:
    """Send each photograph to a node with these parameters; draw and print the results."""
    for is_guessed in sorted({one.intrinsics.is_guessed for one in photographs}):
        with Session({**parameters, 'lens_is_guessed': is_guessed}) as session:
            for photograph in photographs:
                if photograph.intrinsics.is_guessed == is_guessed:
                    _show_one(session, photograph, depth_title, suffix, folder)


def _show_one(session: Session, photograph: Photograph, depth_title: str, suffix: str,
              folder: Path) -> None:
    received, name = session.process(photograph), photograph.name + suffix
    paths = [folder / f'{name}.{kind}' for kind in ('png', 'ply', 'csv')]
    figure = _figure(photograph, depth_title, received)
    cv2.imwrite(str(paths[0]), cv2.cvtColor(figure, cv2.COLOR_RGB2BGR))
    _write_tables(paths[1], paths[2], photograph, received)
    with open(folder / _WRITTEN, 'a', encoding='utf-8') as file:
        file.writelines(f'{path.name}\n' for path in paths)
    _print(name, photograph, received)
    print('  ' + ', '.join(map(str, paths)))


def _write_tables(ply: Path, table: Path, photograph: Photograph, received: Received) -> None:
    """Write the labelled cloud and the rows of the planes."""
    points, labels = received.points, received.points['label']
    xyz_m = np.stack([points['x'], points['y'], points['z']], axis=-1)
    write_ply(ply, xyz_m, drawing.tint(photograph.rgb, labels, _colours(received.planes)), labels,
              in_metres=received.unit == 'm')
    with open(table, 'w', newline='', encoding='utf-8') as file:
        csv.writer(file).writerows([received.planes.dtype.names,
                                    *map(csv_row, received.planes)])


def _print(name: str, photograph: Photograph, received: Received) -> None:
    """Print the table of planes and the time of a frame."""
    size = photograph.intrinsics
    print(f'\n{name}: {size.width} x {size.height}, fx {size.fx:.0f} px, '
          f'{photograph.calibration}; lengths in '
          f'{"metres" if received.unit == "m" else "an unknown unit"}')
    print('\n'.join(f'  {line}' for line in table_lines(received.planes)))
    if not _legend(received.planes):
        print(f'  (no floor, no walls: the direction of gravity is unknown{received.note}; '
              'MOUNTING=upright, or --mounting upright, states that the camera was neither on '
              'its side nor looking straight down)')
    print(f'  {received.frame_ms:.0f} ms from the image to the planes, over topics within one '
          'process')


def _figure(photograph: Photograph, depth_title: str, received: Received) -> np.ndarray:
    """Return image, depth, planes of RANSAC alone, and planes by class."""
    planes, rgb, classes = received.planes, photograph.rgb, _legend(received.planes)
    alone = ransac_alone(received.depth_m) + 1
    limits = f'; fastdepth is {_FASTDEPTH_IS}' if depth_title.endswith('fastdepth') else ''
    return drawing.figure([
        (f'image{limits}', rgb),
        depth_panel(depth_title, received.depth_m, received.unit),
        (f'RANSAC alone: {len(np.unique(alone[alone > 0]))} planes, one colour each',
         drawing.overlay(rgb, alone)),
        (f'{len(planes)} planes{f": {classes}" if classes else ""}',
         drawing.overlay(rgb, received.points['label'], _colours(planes))),
    ])


def _colours(planes: np.ndarray) -> np.ndarray:
    """Return the colour of each label, as in the topics of the node."""
    return drawing.colours_by_label(planes['label'], planes['class'],
                                    int(planes['label'].max(initial=0)))


def _legend(planes: np.ndarray) -> str:
    """Return the classes in the scene with their colours; empty if no class is known."""
    return ', '.join(f'{kind.readable} {name}' for kind, (name, _) in drawing.CLASS_COLOURS.items()
                     if (planes['class'] == kind).any())


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='demo', description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--images', type=Path, help='your own image, or a folder of images')
    for name in ('fx', 'fy', 'cx', 'cy'):
        parser.add_argument(f'--{name}', type=float, help='calibration of these images, pixels')
    parser.add_argument('--fov', type=float,
                        help='horizontal field of view in degrees, instead of a calibration')
    parser.add_argument('--mounting', choices=['any', 'upright'], default='any', help=(
        'upright: the camera was never on its side, upside down or looking straight down, so '
        'lines show the direction of gravity more often (default: %(default)s)'))
    parser.add_argument('--model', default='auto', metavar='NAME|FILE', help=(
        f'depth network: auto, {", ".join(NETWORKS)}, or an .onnx file (default: %(default)s)'))
    parser.add_argument('--model-output', choices=['metric_depth', 'disparity',
                                                   'relative_disparity'],
                        help='kind of output of a network file')
    parser.add_argument('--without-network', action='store_true',
                        help='only process images with measured depth')
    parser.add_argument('--output', type=Path, default=Path('demo_output'),
                        help='folder of the results (default: %(default)s)')
    return parser


if __name__ == '__main__':
    sys.exit(main())
