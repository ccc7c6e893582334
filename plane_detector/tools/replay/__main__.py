# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The program `replay`, also `python3 -m plane_detector.tools.replay`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from plane_detector.stopping import Stopped, leave
from plane_detector.tools.replay.arguments import TOPICS, make_parser
from plane_detector.tools.replay.node_settings import load_settings
from plane_detector.tools.replay.signals import stop_on_signal

_FAILED, _DAMAGED, _INTERRUPTED = 1, 3, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Replay a bag; return the exit code, see `--help`."""
    options = make_parser().parse_args(arguments)
    try:
        # Imported here, so that a missing library is one line and no traceback.
        with stop_on_signal() as should_stop:
            return leave(_run(options, should_stop))
    except (KeyboardInterrupt, Stopped):
        return leave(_INTERRUPTED)
    except (OSError, ValueError, ModuleNotFoundError) as error:
        print(f'replay: {error}', file=sys.stderr)
        return leave(_FAILED)


def _run(arguments: argparse.Namespace, should_stop) -> int:
    from plane_detector.tools.replay.run import replay
    options = _options(arguments)
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


def _options(arguments: argparse.Namespace):
    from plane_detector.tools.replay.options import ReplayOptions
    config, settings = load_settings(arguments.params_file, _assignments(arguments))
    return ReplayOptions(
        source=arguments.input,
        target=arguments.output or Path(f'{arguments.input.stem}_planes'),
        config=config, settings=settings,
        topics={role: name for role in TOPICS if (name := getattr(arguments, role))},
        depth_by_bag=_depth_is_open(arguments, config),
        start_s=arguments.start, duration_s=arguments.duration, every=arguments.every,
        outputs=tuple(arguments.outputs),
        copied=None if arguments.copy is None else tuple(arguments.copy),
        storage=arguments.storage, compressed=arguments.compress, figures=arguments.figures,
        ply=arguments.ply, table=arguments.csv,
        leftover='resume' if arguments.resume else 'refuse')


def _assignments(arguments: argparse.Namespace) -> list[str]:
    """Return the parameters; those that other options stand for come first."""
    by_depth = ['depth.source:=topic'] if arguments.depth else []
    if arguments.network is not None:
        by_depth = ['depth.source:=model']
        by_depth += [f'depth.model:={arguments.network}'] if arguments.network else []
    return [*by_depth, *arguments.parameter]


def _depth_is_open(arguments: argparse.Namespace, config) -> bool:
    """Whether nobody said where depth comes from: neither a topic, nor a network, nor a use."""
    named = {text.partition(':=')[0] for text in arguments.parameter}
    return (not arguments.depth and arguments.network is None
            and named.isdisjoint({'depth.source', 'depth.model'})
            and config.depth.source == 'model' and config.scale.method != 'depth_topic')


if __name__ == '__main__':
    sys.exit(main())
