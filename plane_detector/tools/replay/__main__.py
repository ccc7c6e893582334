# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Find the planes in every picture of a bag, as fast as it goes, and write them into a new bag.

Every frame goes through the same code as in the node, without topics in between: none is
dropped, and the same frames give the same planes.
"""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from plane_detector.ros.outputs.topics import OUTPUTS
from plane_detector.tools.replay.node_settings import load_settings

_INTERRUPTED = 130
_TOPICS = {'image': 'sensor_msgs/Image or CompressedImage', 'camera_info': 'its CameraInfo',
           'depth': 'measured depth of the picture, taken instead of the network unless '
                    '-p depth.source:=model', 'imu': 'sensor_msgs/Imu'}


def main(arguments: Sequence[str] | None = None) -> int:
    """Replay a bag; return the exit code: 0, 1 with a message, or 130 when interrupted."""
    arguments = _parser().parse_args(arguments)
    try:
        # Imported here, so that a missing library is one line and no traceback.
        from plane_detector.tools.replay.run import replay
        options = _options(arguments)
        with _stop_on_signal() as should_stop:
            tally = replay(options, should_stop)
    except KeyboardInterrupt:
        return _INTERRUPTED
    except (OSError, ValueError, ModuleNotFoundError) as error:
        print(f'replay: {error}', file=sys.stderr)
        return 1
    print(tally.describe())
    if tally.processed:
        print(f'The planes are in {options.target}')
    if tally.failure:
        print(f'replay: {tally.failure}', file=sys.stderr)
        return 1
    return _INTERRUPTED if tally.interrupted else 0


def _options(arguments: argparse.Namespace):
    from plane_detector.tools.replay.run import ReplayOptions
    by_depth = ['depth.source:=topic'] if arguments.depth else []
    assignments = [*by_depth, *arguments.parameter]
    config, settings = load_settings(arguments.params_file, assignments)
    return ReplayOptions(
        source=arguments.input,
        target=arguments.output or Path(f'{arguments.input.stem}_planes'),
        config=config, settings=settings,
        topics={role: name for role in _TOPICS if (name := getattr(arguments, role))},
        start_s=arguments.start, duration_s=arguments.duration, every=arguments.every,
        outputs=tuple(arguments.outputs),
        copied=None if arguments.copy is None else tuple(arguments.copy),
        storage=arguments.storage, compressed=arguments.compress, figures=arguments.figures,
        ply=arguments.ply, table=arguments.csv)


@contextmanager
def _stop_on_signal() -> Iterator[Callable[[], bool]]:
    """Yield whether SIGINT or SIGTERM came; a second one ends the program at once."""
    came: list[int] = []

    def remember(number: int, _stack: object) -> None:
        came.append(number)
        signal.signal(number, before[number])

    before = {number: signal.signal(number, remember)
              for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(came)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='replay', description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('input', type=Path, metavar='INPUT',
                        help='rosbag2 folder (sqlite3, mcap, compressed), .mcap, .db3, or ROS 1 '
                             '.bag')
    parser.add_argument('output', type=Path, nargs='?', metavar='OUTPUT',
                        help='new rosbag2 folder (default: INPUT_planes, here)')
    _add_inputs(parser.add_argument_group('what is read'))
    _add_settings(parser.add_argument_group('how it is processed'))
    _add_outputs(parser.add_argument_group('what is written'))
    return parser


def _add_inputs(group: argparse._ArgumentGroup) -> None:
    for role, meaning in _TOPICS.items():
        group.add_argument('--' + role.replace('_', '-'), metavar='TOPIC',
                           help=f'{meaning} (default: looked for)')
    group.add_argument('--start', type=_seconds, default=0.0, metavar='SECONDS',
                       help='leave out the beginning of the bag')
    group.add_argument('--duration', type=_seconds, default=float('inf'), metavar='SECONDS',
                       help='stop after so much recorded time')
    group.add_argument('--every', type=_positive, default=1, metavar='N',
                       help='take every n-th frame only')


def _add_settings(group: argparse._ArgumentGroup) -> None:
    group.add_argument('--params-file', type=Path, metavar='YAML',
                       help='parameters of the node, as for ros2 run')
    group.add_argument('-p', '--parameter', action='append', default=[], metavar='NAME:=VALUE',
                       help='one of them, as for ros2 run: -p depth.source:=topic')


def _add_outputs(group: argparse._ArgumentGroup) -> None:
    group.add_argument('--outputs', nargs='+', choices=list(OUTPUTS), default=list(OUTPUTS),
                       help='topics of the new bag (default: all)')
    group.add_argument('--copy', nargs='*', metavar='TOPIC',
                       help='copy these topics into the new bag; without a name: the inputs')
    group.add_argument('--storage', choices=['mcap', 'sqlite3'], default='mcap',
                       help='of the new bag (default: %(default)s)')
    group.add_argument('--compress', action='store_true', help='compress the new bag by zstd')
    group.add_argument('--figures', type=Path, metavar='FOLDER',
                       help='picture, depth and planes of each frame as .jpg')
    group.add_argument('--ply', type=Path, metavar='FOLDER', help='labelled cloud of each frame')
    group.add_argument('--csv', type=Path, metavar='FILE', help='table of all planes')


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


if __name__ == '__main__':
    sys.exit(main())
