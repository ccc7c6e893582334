# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The program `replay`: its arguments, what it prints, and its exit codes."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from plane_detector import PAGES
from plane_detector._runtime.dependencies import explained_imports
from plane_detector._runtime.ending import (
    FAILED,
    INTERRUPTED,
    end_process,
    quiet_interrupt,
    run_program,
    until_signal,
)

with quiet_interrupt(), explained_imports('numba', 'scipy'):
    from plane_detector.config import NodeConfig
    from plane_detector.depth.networks import NETWORKS
    from plane_detector.ros.outputs.topics import OUTPUTS
    from plane_detector.tools.replay import many_bags
    from plane_detector.tools.replay.bag_reader import bag_name
    from plane_detector.tools.replay.options import DEFAULT_OUTPUTS, ReplayOptions, load_settings
    from plane_detector.tools.replay.replay_bag import replay

TOPICS = {'image': 'sensor_msgs/Image or CompressedImage', 'camera_info': 'its CameraInfo',
          'depth': 'measured depth of the image, used instead of a network',
          'imu': 'sensor_msgs/Imu'}
DESCRIPTION = """
Find the planes in every image of a bag, as fast as possible, and write them "
              "into a new bag.

Every frame is processed by the code of the node, without topics "
              "in between: no frame is dropped, and
the same frames give the same planes. If the "
              "bag has measured depth for the image (same frame_id
and size), it is used; a "
              "network is used only if there is none, or with --network.
"""
USAGE = """
  replay [options] INPUT [OUTPUT]                       one bag (default: INPUT_planes, here)
  replay [options] INPUT INPUT... FOLDER                many bags into a folder
  replay [options] --output-folder FOLDER INPUT...      the same"""
EXIT_CODES = f"""
exit codes: 0 finished; 1 failed, or one of many bags failed; 2 wrong arguments; 3 finished, but
frames or damaged messages were skipped, or images between the first and the last frame had no
calibration or depth; 130 ended by a signal; 128 + its number: at once, because
this took too long or another signal came.

More: {PAGES}/replay.md
"""
_INCOMPLETE = 3


def main(arguments: Sequence[str] | None = None) -> int:
    """Replay one bag or many; return the exit code, see `--help`."""
    options = parse(sys.argv[1:] if arguments is None else arguments)
    return run_program('replay', lambda: _run(options))


def _run(arguments: argparse.Namespace) -> int:
    paths, folder = list(arguments.paths), arguments.output_folder
    if folder is None and (len(paths) > 2 or many_bags.is_collection(paths[0])):
        folder = Path(paths.pop() if len(paths) > 1 else f'{Path(paths[0]).name}_planes')
    if folder is not None:
        return _run_many(arguments, paths, folder)
    source = Path(paths[0])
    target = Path(paths[1] if len(paths) > 1 else f'{bag_name(source)}_planes')
    return _run_one(_options(arguments, source, target))


def _run_one(options: ReplayOptions) -> int:
    tally = until_signal(lambda: replay(options))
    print(tally.describe())
    if tally.interrupted:
        print(f'Interrupted: the planes of the frames so far are in {tally.target}')
        return INTERRUPTED
    print(f'The planes are in {tally.target}')
    if tally.is_clean:
        return 0
    print(f'replay: not everything could be used: {"; ".join(tally.losses())}', file=sys.stderr)
    return _INCOMPLETE


def _run_many(arguments: argparse.Namespace, inputs: Sequence[str], folder: Path) -> int:
    received = []

    def interrupt(number: int, _: object) -> None:
        received.append(number)
        raise KeyboardInterrupt  # joblib ends its workers
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, interrupt)
    bags = many_bags.find_bags(inputs, folder.resolve())
    options = _options(arguments, Path(), folder)
    try:
        summaries = many_bags.replay_many(bags, options, arguments.jobs)
    except (KeyboardInterrupt, OSError):
        # A terminal signals the workers too, so the end of a worker may be noticed first.
        if not received:
            raise
        end_process(INTERRUPTED)  # a cluster on this machine ends with this process
    print(many_bags.describe(summaries))
    print(f'The planes are in {folder}, this table in {folder / many_bags.SUMMARY_NAME}')
    if any(one.state == many_bags.FAILED for one in summaries):
        return FAILED
    is_incomplete = any(one.skipped or one.damaged or one.unpaired for one in summaries)
    return _INCOMPLETE if is_incomplete else 0


def _options(arguments: argparse.Namespace, source: Path, target: Path) -> ReplayOptions:
    # Parameters set by other options come first.
    by_depth = ['depth.source:=topic'] if arguments.depth else []
    if arguments.network is not None:
        by_depth = ['depth.source:=model']
        by_depth += [f'depth.model:={arguments.network}'] if arguments.network else []
    by_map = ['map.enabled:=true'] if arguments.map or arguments.load else []
    config, settings = load_settings(arguments.params_file,
                                     [*by_depth, *by_map, *arguments.parameter],
                                     NodeConfig(points_color='overlay'))  # as a viewer shows it
    named = {text.partition(':=')[0] for text in [*by_depth, *arguments.parameter]}
    depth_by_bag = (named.isdisjoint({'depth.source', 'depth.model'})
                    and not config.depth.is_measured and config.scale.method != 'depth_topic')
    return ReplayOptions(
        source=source, target=target, config=config, settings=settings,
        topics={role: name for role in TOPICS if (name := getattr(arguments, role))},
        depth_by_bag=depth_by_bag, start_s=arguments.start, duration_s=arguments.duration,
        every=arguments.every, outputs=tuple(arguments.outputs),
        copied=None if arguments.copy is None else tuple(arguments.copy),
        storage=arguments.storage, compressed=arguments.compress, figures=arguments.figures,
        ply=arguments.ply, table=arguments.csv, map_file=arguments.map, load_map=arguments.load)


def parse(words: Sequence[str]) -> argparse.Namespace:
    """Parse the command line; `--network` takes the next word only if it names a network."""
    words = list(words)
    for k, word in enumerate(words):
        if word == '--network' and not (words[k + 1:] and (
                words[k + 1] in ('auto', *NETWORKS) or words[k + 1].endswith('.onnx'))):
            words[k] = '--network='
    return _make_parser().parse_intermixed_args(words)


def _make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='replay', description=DESCRIPTION, epilog=EXIT_CODES, usage=USAGE,
        formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('paths', nargs='+', metavar='INPUT', help=(
        'rosbag2 folder (sqlite3, mcap, compressed), .mcap, .db3 or ROS 1 .bag; for many bags, '
        'any number of these, of folders with bags and of quoted patterns'))
    parser.add_argument('--output-folder', type=Path, metavar='FOLDER', help=(
        'process many bags: folder for the new bags and summary.csv; all paths are then inputs'))

    add = parser.add_argument_group('inputs').add_argument
    for role, meaning in TOPICS.items():
        add('--' + role.replace('_', '-'), metavar='TOPIC',
            help=f'{meaning} (default: found by type and name)')
    add('--start', type=_seconds, default=0.0, metavar='SECONDS',
        help='skip the beginning of the bag')
    add('--duration', type=_seconds, default=float('inf'), metavar='SECONDS',
        help='process only this much recorded time')
    add('--every', type=_positive, default=1, metavar='N', help='process only every n-th frame')

    add = parser.add_argument_group('processing').add_argument
    add('--network', metavar='[NAME]',
        help='use a network even if the bag has measured depth: depth.model, or the network or '
             '.onnx file named here')
    add('--params-file', type=Path, metavar='YAML', help='parameters of the node, as for ros2 run')
    add('-p', '--parameter', action='append', default=[], metavar='NAME:=VALUE',
        help='one parameter, as for ros2 run: -p scale.camera_height:=1.2')

    add = parser.add_argument_group('outputs').add_argument
    add('--outputs', nargs='+', choices=list(OUTPUTS), default=list(DEFAULT_OUTPUTS),
        help='topics of the new bag (default: all but '
             f'{" ".join(name for name in OUTPUTS if name not in DEFAULT_OUTPUTS)})')
    add('--copy', nargs='*', metavar='TOPIC',
        help='copy these topics into the new bag; without a name: the inputs. With --every, only '
             'the inputs of the processed frames')
    add('--storage', choices=['mcap', 'sqlite3'], default='mcap',
        help='format of the new bag (default: %(default)s)')
    add('--compress', action='store_true', help='compress the new bag with zstd')
    add('--figures', type=Path, metavar='FOLDER',
        help='image, depth and planes of each frame as .jpg; with many bags --figures, --ply and '
             '--csv name folders with one entry per bag')
    add('--ply', type=Path, metavar='FOLDER', help='labelled cloud of each frame')
    add('--csv', type=Path, metavar='FILE',
        help='table of all planes; with shapes.types also one of all shapes')

    add('--map', type=Path, metavar='FILE',
        help='keep a map of planes in target_frame (-p target_frame:=odom) and write it to this '
             'file; with many bags the name of a folder')
    add('--load', type=Path, metavar='FILE', help='continue from this map')

    add = parser.add_argument_group('many bags').add_argument
    add('--jobs', type=_jobs, default=-1, metavar='N',
        help='number of bags processed at a time, one thread each (default: all cores)')
    return parser


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


if __name__ == '__main__':
    sys.exit(main())
