# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Replay of one bag or many, with the arguments and exit codes of the command line."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from plane_detector.config import Config
from plane_detector.stopping import Stopped, leave
from plane_detector.tools.replay.arguments import TOPICS, parse
from plane_detector.tools.replay.node_settings import load_settings
from plane_detector.tools.replay.signals import ShouldStop, stop_on_signal

if TYPE_CHECKING:
    from plane_detector.tools.replay.options import ReplayOptions

_FAILED, _DAMAGED, _INTERRUPTED = 1, 3, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Replay one bag or many; return the exit code, see `--help`."""
    options = parse(sys.argv[1:] if arguments is None else arguments)
    try:
        # Imported here, so that a missing library gives one line instead of a traceback.
        with stop_on_signal() as should_stop:
            return leave(_run(options, should_stop))
    except (KeyboardInterrupt, Stopped):
        return leave(_INTERRUPTED)
    except (OSError, ValueError, ModuleNotFoundError) as error:
        print(f'replay: {error}', file=sys.stderr)
        return leave(_FAILED)


def _run(arguments: argparse.Namespace, should_stop: ShouldStop) -> int:
    from plane_detector.tools.replay.find_bags import is_collection
    paths, folder = list(arguments.paths), arguments.output_folder
    if folder is None and (len(paths) > 2 or is_collection(paths[0])):
        folder = Path(paths.pop() if len(paths) > 1 else f'{Path(paths[0]).name}_planes')
    if folder is not None:
        return _run_many(arguments, paths, folder, should_stop)
    source = Path(paths[0])
    target = Path(paths[1]) if len(paths) > 1 else Path(f'{source.stem}_planes')
    return _run_one(_options(arguments, source, target), should_stop)


def _run_one(options: ReplayOptions, should_stop: ShouldStop) -> int:
    from plane_detector.tools.replay.run import replay
    tally = replay(options, should_stop)
    print(tally.describe())
    if tally.processed:
        print(f'The planes are in {options.target}')
    if tally.failure:
        print(f'replay: {tally.failure}', file=sys.stderr)
        return _FAILED
    if tally.interrupted:
        return _INTERRUPTED
    return _DAMAGED if tally.damaged else 0


def _run_many(arguments: argparse.Namespace, inputs: Sequence[str], folder: Path,
              should_stop: ShouldStop) -> int:
    from plane_detector.tools.replay import many
    from plane_detector.tools.replay.find_bags import find_bags
    bags = find_bags(inputs, folder.resolve())
    jobs = many.make_jobs(bags, folder, _options(arguments, Path(), folder))
    pool = many.Pool(arguments.backend, arguments.jobs, arguments.scheduler)
    summaries = many.replay_many(jobs, folder, pool, should_stop)
    print(many.describe(summaries))
    print(f'The planes are in {folder}, this table in {folder / many.SUMMARY_NAME}')
    states = {one.state for one in summaries}
    if should_stop():
        return _INTERRUPTED
    if not states <= {'finished', 'done before'}:
        return _FAILED
    return _DAMAGED if any(one.damaged for one in summaries) else 0


def _options(arguments: argparse.Namespace, source: Path, target: Path) -> ReplayOptions:
    from plane_detector.tools.replay.options import ReplayOptions
    config, settings = load_settings(arguments.params_file, _assignments(arguments))
    return ReplayOptions(
        source=source, target=target, config=config, settings=settings,
        topics={role: name for role in TOPICS if (name := getattr(arguments, role))},
        depth_by_bag=_depth_is_open(arguments, config),
        start_s=arguments.start, duration_s=arguments.duration, every=arguments.every,
        outputs=tuple(arguments.outputs),
        copied=None if arguments.copy is None else tuple(arguments.copy),
        storage=arguments.storage, compressed=arguments.compress, figures=arguments.figures,
        ply=arguments.ply, table=arguments.csv,
        leftover='resume' if arguments.resume else 'refuse')


def _assignments(arguments: argparse.Namespace) -> list[str]:
    """Return the parameters; those set by other options come first."""
    by_depth = ['depth.source:=topic'] if arguments.depth else []
    if arguments.network is not None:
        by_depth = ['depth.source:=model']
        by_depth += [f'depth.model:={arguments.network}'] if arguments.network else []
    return [*by_depth, *arguments.parameter]


def _depth_is_open(arguments: argparse.Namespace, config: Config) -> bool:
    """Whether the source of depth is not given: no topic, no network, no parameter."""
    named = {text.partition(':=')[0] for text in arguments.parameter}
    return (not arguments.depth and arguments.network is None
            and named.isdisjoint({'depth.source', 'depth.model'})
            and config.depth.source == 'model' and config.scale.method != 'depth_topic')
