# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Benchmarks of the package, with results as Markdown. One program, one subcommand per subject.

    python3 -m plane_detector.evaluation.benchmark labelled --frames
    python3 -m plane_detector.evaluation.benchmark accuracy --plots docs/figures
    python3 -m plane_detector.evaluation.benchmark SUBCOMMAND --help

Every run first prints its command, the machine, the versions and the commit. The benchmarks are
not installed with the package.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence
from types import ModuleType

from plane_detector.evaluation.benchmark.report import PROGRAM, emit, provenance

# Subcommand: its module, which has add_arguments(parser) and run(options), and a summary. A module
# is imported only if its subcommand runs, because some need ROS and others optional packages.
COMMANDS = {
    'accuracy': ('accuracy', 'accuracy and time on all kinds of scenes, in one run'),
    'labelled': ('labelled', 'real frames with planes labelled by hand'),
    'map': ('map', 'the map of planes, on rendered walks'),
    'ground': ('ground', 'ground, obstacles and drops on rendered terrain'),
    'shapes': ('shapes', 'spheres, cylinders and cones among planes'),
    'relative': ('relative', 'angles in relative disparity with the errors of a network'),
    'orientation': ('orientation', 'directions from lines, and planes with them'),
    'network': ('network', 'depth networks on an execution provider'),
    'node': ('node', 'the node as a process, over DDS'),
    'ablation': ('ablation', 'each stage of the segmentation switched off'),
}


def subcommand(name: str) -> tuple[ModuleType, argparse.ArgumentParser]:
    """Return the module of a subcommand and the parser of its options."""
    module_name, summary = COMMANDS[name]
    module = importlib.import_module(f'plane_detector.evaluation.benchmark.{module_name}')
    parser = argparse.ArgumentParser(prog=f'{PROGRAM} {name}', description=summary)
    module.add_arguments(parser)
    return module, parser


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a subcommand; wrong arguments and wrong input end with a message and a code above 0."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    width = max(map(len, COMMANDS))
    parser = argparse.ArgumentParser(
        prog=PROGRAM, description=__doc__.splitlines()[1],
        formatter_class=argparse.RawDescriptionHelpFormatter, epilog='\n'.join(
            f'{name:{width}}  {summary}' for name, (_, summary) in COMMANDS.items()))
    parser.add_argument('subcommand', choices=COMMANDS, metavar='SUBCOMMAND',
                        help='one of those listed below; each has its own --help')
    name = parser.parse_args(arguments[:1]).subcommand
    module, subparser = subcommand(name)
    options = subparser.parse_args(arguments[1:])
    emit(provenance(arguments))
    try:
        module.run(options)
    except (ValueError, OSError, ImportError, RuntimeError) as error:
        sys.exit(f'{PROGRAM} {name}: {error}')
    except KeyboardInterrupt:
        print(f'{PROGRAM} {name}: interrupted', file=sys.stderr)
        sys.exit(130)  # 128 + SIGINT, as shells have it


if __name__ == '__main__':
    main()
