# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The command line of the replay."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from plane_detector.depth.model_zoo import NETWORKS
from plane_detector.ros.outputs.topics import OUTPUTS

BACKENDS = ('processes', 'dask', 'ray')
TOPICS = {'image': 'sensor_msgs/Image or CompressedImage', 'camera_info': 'its CameraInfo',
          'depth': 'measured depth of the image, taken instead of a network',
          'imu': 'sensor_msgs/Imu'}
DESCRIPTION = """
Find the planes in every image of a bag, as fast as it goes, and write them into a new bag.

Every frame goes through the same code as in the node, without topics in between: none is
dropped, and the same frames give the same planes. Measured depth that the bag has for the image
(same frame_id and size) is taken; a network only where there is none, or with --network.
"""
USAGE = """
  replay [options] INPUT [OUTPUT]                       one bag (default: INPUT_planes, here)
  replay [options] INPUT INPUT... FOLDER                many bags into a folder
  replay [options] --output-folder FOLDER INPUT...      the same"""
EXIT_CODES = """
exit codes: 0 done; 1 failed, or one of many bags did; 2 wrong arguments; 3 done, but damaged
messages were left out; 130 ended by a signal, what was written is whole.
"""


def parse(words: Sequence[str]) -> argparse.Namespace:
    """Parse the command line; `--network` takes the next word only if that names a network."""
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
        'rosbag2 folder (sqlite3, mcap, compressed), .mcap, .db3 or ROS 1 .bag; of many bags '
        'also a folder of them or a quoted pattern, and as many as you like'))
    parser.add_argument('--output-folder', type=Path, metavar='FOLDER', help=(
        'of many bags: the new ones go there, and summary.csv; all paths are inputs then'))
    parser.add_argument('--resume', action='store_true',
                        help='go on with what a run left that was interrupted or killed')
    _add_inputs(parser.add_argument_group('what is read'))
    _add_settings(parser.add_argument_group('how it is processed'))
    _add_outputs(parser.add_argument_group('what is written'))
    _add_workers(parser.add_argument_group('many bags'))
    return parser


def _add_inputs(group: argparse._ArgumentGroup) -> None:
    for role, meaning in TOPICS.items():
        group.add_argument('--' + role.replace('_', '-'), metavar='TOPIC',
                           help=f'{meaning} (default: looked for)')
    group.add_argument('--start', type=_seconds, default=0.0, metavar='SECONDS',
                       help='leave out the beginning of the bag')
    group.add_argument('--duration', type=_seconds, default=float('inf'), metavar='SECONDS',
                       help='stop after so much recorded time')
    group.add_argument('--every', type=_positive, default=1, metavar='N',
                       help='take every n-th frame only')


def _add_settings(group: argparse._ArgumentGroup) -> None:
    group.add_argument('--network', metavar='[NAME]',
                       help='take depth from a network though the bag has measured depth: the '
                            'one of depth.model, or this one of the zoo, or this .onnx file')
    group.add_argument('--params-file', type=Path, metavar='YAML',
                       help='parameters of the node, as for ros2 run')
    group.add_argument('-p', '--parameter', action='append', default=[], metavar='NAME:=VALUE',
                       help='one of them, as for ros2 run: -p scale.camera_height:=1.2')


def _add_outputs(group: argparse._ArgumentGroup) -> None:
    group.add_argument('--outputs', nargs='+', choices=list(OUTPUTS), default=list(OUTPUTS),
                       help='topics of the new bag (default: all)')
    group.add_argument('--copy', nargs='*', metavar='TOPIC',
                       help='copy these topics into the new bag; without a name: the inputs. '
                            'With --every, of the inputs what belongs to the frames taken')
    group.add_argument('--storage', choices=['mcap', 'sqlite3'], default='mcap',
                       help='of the new bag (default: %(default)s)')
    group.add_argument('--compress', action='store_true', help='compress the new bag by zstd')
    group.add_argument('--figures', type=Path, metavar='FOLDER',
                       help='image, depth and planes of each frame as .jpg; of many bags a '
                            'folder each in it, as for --ply and --csv')
    group.add_argument('--ply', type=Path, metavar='FOLDER', help='labelled cloud of each frame')
    group.add_argument('--csv', type=Path, metavar='FILE', help=(
        'table of all planes; with shapes.types there is one of all shapes beside it'))


def _add_workers(group: argparse._ArgumentGroup) -> None:
    group.add_argument('--jobs', type=_jobs, default=-1, metavar='N',
                       help='bags at a time, one thread each (default: the number of cores)')
    group.add_argument('--backend', choices=BACKENDS, default='processes',
                       help='processes of this machine, or a cluster that shares the folders '
                            '(default: %(default)s)')
    group.add_argument('--scheduler', default='', metavar='ADDRESS',
                       help='of the cluster; for ray, none: one on this machine, for this run')


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
