# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Command line of the replay."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from plane_detector.depth.model_zoo import NETWORKS
from plane_detector.ros.outputs.topics import OUTPUTS

BACKENDS = ('processes', 'dask', 'ray')
TOPICS = {'image': 'sensor_msgs/Image or CompressedImage', 'camera_info': 'its CameraInfo',
          'depth': 'measured depth of the image, used instead of a network',
          'imu': 'sensor_msgs/Imu'}
DESCRIPTION = """
Find the planes in every image of a bag, as fast as possible, and write them into a new bag.

Every frame is processed by the code of the node, without topics in between: none is dropped, and
the same frames give the same planes. If the bag has measured depth for the image (same frame_id
and size), it is used; a network is used only if there is none, or with --network.
"""
USAGE = """
  replay [options] INPUT [OUTPUT]                       one bag (default: INPUT_planes, here)
  replay [options] INPUT INPUT... FOLDER                many bags into a folder
  replay [options] --output-folder FOLDER INPUT...      the same"""
EXIT_CODES = """
exit codes: 0 finished; 1 failed, or one of many bags failed; 2 wrong arguments; 3 finished, but
damaged messages were skipped; 130 ended by a signal, the results so far are complete.
"""


def parse(words: Sequence[str]) -> argparse.Namespace:
    """Parse the command line; `--network` takes the next word only if it names a network."""
    words = list(words)
    for k, word in enumerate(words[:-1]):
        if word == '--network' and not (words[k + 1] in NETWORKS or words[k + 1] == 'auto'
                                        or words[k + 1].endswith('.onnx')):
            words[k] = '--network='
    if words[-1:] == ['--network']:
        words[-1] = '--network='
    return _make_parser().parse_intermixed_args(words)


def _make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog='replay', description=DESCRIPTION, epilog=EXIT_CODES, usage=USAGE,
        formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('paths', nargs='+', metavar='INPUT', help=(
        'rosbag2 folder (sqlite3, mcap, compressed), .mcap, .db3 or ROS 1 .bag; for many bags '
        'any number of these, of folders of bags and of quoted patterns'))
    parser.add_argument('--output-folder', type=Path, metavar='FOLDER', help=(
        'process many bags: folder of the new bags and of summary.csv; all paths are inputs then'))
    parser.add_argument('--resume', action='store_true',
                        help='continue a run that was interrupted or killed')
    _add_inputs(parser.add_argument_group('inputs'))
    _add_settings(parser.add_argument_group('processing'))
    _add_outputs(parser.add_argument_group('outputs'))
    _add_workers(parser.add_argument_group('many bags'))
    return parser


def _add_inputs(group: argparse._ArgumentGroup) -> None:
    for role, meaning in TOPICS.items():
        group.add_argument('--' + role.replace('_', '-'), metavar='TOPIC',
                           help=f'{meaning} (default: found by type and name)')
    group.add_argument('--start', type=_seconds, default=0.0, metavar='SECONDS',
                       help='skip the beginning of the bag')
    group.add_argument('--duration', type=_seconds, default=float('inf'), metavar='SECONDS',
                       help='process only this much recorded time')
    group.add_argument('--every', type=_positive, default=1, metavar='N',
                       help='process only every n-th frame')


def _add_settings(group: argparse._ArgumentGroup) -> None:
    group.add_argument('--network', metavar='[NAME]',
                       help='use a network even if the bag has measured depth: that of '
                            'depth.model, or the one named here, or an .onnx file')
    group.add_argument('--params-file', type=Path, metavar='YAML',
                       help='parameters of the node, as for ros2 run')
    group.add_argument('-p', '--parameter', action='append', default=[], metavar='NAME:=VALUE',
                       help='one parameter, as for ros2 run: -p scale.camera_height:=1.2')


def _add_outputs(group: argparse._ArgumentGroup) -> None:
    group.add_argument('--outputs', nargs='+', choices=list(OUTPUTS), default=list(OUTPUTS),
                       help='topics of the new bag (default: all)')
    group.add_argument('--copy', nargs='*', metavar='TOPIC',
                       help='copy these topics into the new bag; without a name: the inputs. '
                            'With --every, only the inputs of the processed frames')
    group.add_argument('--storage', choices=['mcap', 'sqlite3'], default='mcap',
                       help='format of the new bag (default: %(default)s)')
    group.add_argument('--compress', action='store_true', help='compress the new bag with zstd')
    group.add_argument('--figures', type=Path, metavar='FOLDER',
                       help='image, depth and planes of each frame as .jpg; with many bags '
                            '--figures, --ply and --csv name folders with one entry per bag')
    group.add_argument('--ply', type=Path, metavar='FOLDER', help='labelled cloud of each frame')
    group.add_argument('--csv', type=Path, metavar='FILE', help=(
        'table of all planes; with shapes.types also one of all shapes'))


def _add_workers(group: argparse._ArgumentGroup) -> None:
    group.add_argument('--jobs', type=_jobs, default=-1, metavar='N',
                       help='bags processed at a time, one thread each (default: number of '
                            'cores); on Dask the cluster decides')
    group.add_argument('--backend', choices=BACKENDS, default='processes',
                       help='processes on this machine, or a cluster that shares the folders '
                            '(default: %(default)s)')
    group.add_argument('--scheduler', default='', metavar='ADDRESS',
                       help='address of the cluster; ray without it: started here for this run')


def _seconds(text: str) -> float:
    value = float(text)
    if not 0 <= value < float('inf'):
        raise argparse.ArgumentTypeError(f'must be a number of seconds, not {text}')
    return value


def _positive(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f'must be at least 1, not {text}')
    return value


def _jobs(text: str) -> int:
    return -1 if text == '-1' else _positive(text)
