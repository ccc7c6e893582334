# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Demo: starts the node, sends it photographs, and draws the planes that it publishes.

Without --images it uses two photographs that are included in libraries. The first one, a workshop,
is similar to the training images of indoor networks and has a true depth. With it, the demo states
which planes are right, and runs a second time with that depth on the depth topic, as from a depth
camera. The second photograph is outdoors, where these networks do badly.
"""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import rclpy
from rclpy.signals import SignalHandlerOptions
from tqdm import tqdm

from plane_detector.config import Config
from plane_detector.depth.model_zoo import choose, fetch
from plane_detector.depth.networks import NETWORKS
from plane_detector.ros.kernels import load_kernels
from plane_detector.segmentation.baselines import ransac_alone
from plane_detector.tools.demo.node_client import NodeClient
from plane_detector.tools.demo.node_process import NodeProcess, use_private_domain
from plane_detector.tools.demo.photographs import (
    Lens,
    Photograph,
    folder_images,
    library_images,
)
from plane_detector.tools.demo.report import Outcome, print_outcome, write_files

_MEASURED_S = 4.0
_START_TIMEOUT_S = 120.0
_FRAME_TIMEOUT_S = 60.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demo; return the exit code."""
    options = _parser().parse_args(arguments)
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        _run(options)
    except KeyboardInterrupt:
        return 130
    except (OSError, RuntimeError, ValueError, ModuleNotFoundError) as error:
        print(f'\ndemo: {error}', file=sys.stderr)
        return 1
    return 0


def _interrupt(_number: int, _stack: object) -> None:
    """End as with Ctrl-C: the node is ended too, and nothing is printed."""
    raise KeyboardInterrupt


def _run(options: argparse.Namespace) -> None:
    lens = Lens(options.fx, options.fy, options.cx, options.cy, options.fov)
    if options.images and options.without_network:
        raise ValueError('images of a folder have no measured depth: they need the network')
    if lens != Lens() and not options.images:
        raise ValueError('a calibration or a field of view is for your own images: name their '
                         'folder by --images (make demo IMAGES=...)')
    photographs = (folder_images(options.images, lens) if options.images
                   else library_images())
    options.output.mkdir(parents=True, exist_ok=True)
    network = {} if options.without_network else _network(options)
    load_kernels(Config(), print)  # here, as it takes a slow machine longer than a node may take
    use_private_domain()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        if network:
            _show(photographs, network, Path(network['depth.model']).stem, options.output)
        measured = [photograph for photograph in photographs
                    if photograph.true_depth_m is not None]
        if measured:
            _show(measured, {'depth.source': 'topic'}, 'depth topic', options.output)
    finally:
        rclpy.try_shutdown()
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
        print(f'Depth network: {path}, {options.model_output}')
        return {'depth.model': str(path.absolute()), 'depth.output': options.model_output}
    if model == 'auto':
        network, path, reason = choose()
    else:
        network, path, reason = NETWORKS[model], fetch(model), f'{model} as requested'
    print(f'Depth network: {reason}.\n  {path}\n  {network.output}, {network.summary}')
    return {'depth.model': network.name}


def _show(photographs: Sequence[Photograph], parameters: dict[str, str], source: str,
          folder: Path) -> None:
    """Start the node, process each photograph, and report."""
    from_topic = source == 'depth topic'
    inputs = ['image', 'camera_info', *(['depth'] if from_topic else [])]
    log_path = folder / ('node_depth_topic.log' if from_topic else 'node.log')
    with NodeProcess(parameters, log_path) as process:
        client = NodeClient(process.check_running, inputs)
        try:
            with _progress('starting the node') as tick:
                client.wait_until_ready(_START_TIMEOUT_S, tick)
            for photograph in photographs:
                outcome = _outcome(client, photograph, source)
                print_outcome(outcome, write_files(outcome, folder))
        except TimeoutError as error:
            raise RuntimeError(f'{error}.\n{process.last_words()}') from error
        finally:
            client.close()


def _outcome(client: NodeClient, photograph: Photograph, source: str) -> Outcome:
    """Process a photograph: once for the results, then repeatedly to measure the time."""
    with _progress(f'{photograph.name}: frames') as tick:
        received = client.process(photograph, _FRAME_TIMEOUT_S)
        timing = client.measure(photograph, _MEASURED_S, _FRAME_TIMEOUT_S, tick)
    with _progress(f'{photograph.name}: RANSAC alone, for comparison') as tick:
        tick()
        ransac_labels = ransac_alone(received.depth_m) + 1
    return Outcome(photograph, source, received, timing, ransac_labels)


@contextmanager
def _progress(what: str) -> Iterator[Callable[[], object]]:
    """Show the current step and its duration, on a line that is erased at the end."""
    with tqdm(desc=what, bar_format='{desc} {n_fmt} [{elapsed}]', leave=False,
              disable=None) as bar:
        yield bar.update


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
