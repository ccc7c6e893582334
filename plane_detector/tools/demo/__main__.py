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
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from plane_detector.dependencies import explained_imports
from plane_detector.stopping import leave, quiet_interrupt

with quiet_interrupt(), explained_imports('numba', installed=['scipy']):
    from plane_detector.config import DepthConfig
    from plane_detector.depth.networks import NETWORKS, resolve
    from plane_detector.ros.spinning import CannotRunError
    from plane_detector.tools.demo.photographs import (
        Lens,
        Photograph,
        folder_images,
        library_images,
    )
    from plane_detector.tools.demo.report import Outcome, print_outcome, write_files
    from plane_detector.tools.demo.session import Session

_FAILED, _INTERRUPTED = 1, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demo; return the exit code."""
    options = _parser().parse_args(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        _run(options)
    except KeyboardInterrupt:
        return leave(_INTERRUPTED)
    except (OSError, ValueError, ModuleNotFoundError, CannotRunError) as error:
        print(f'\ndemo: {error}', file=sys.stderr)
        return leave(_FAILED)
    return leave(0)


def _run(options: argparse.Namespace) -> None:
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
    network, path, reason = resolve(DepthConfig(model=model))
    print(f'Depth network: {reason}.\n  {path}\n  {network.output}, {network.summary}')
    return {'depth.model': network.name}


def _show(photographs: Sequence[Photograph], parameters: dict[str, str], depth_title: str,
          suffix: str, folder: Path) -> None:
    """Send each photograph to a node with these parameters, and report."""
    with Session(parameters) as session:
        for photograph in photographs:
            outcome = Outcome(photograph, photograph.name + suffix, depth_title,
                              session.process(photograph))
            print_outcome(outcome, write_files(outcome, folder))


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
