# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Options of several subcommands, each declared once."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

HELD_OUT = 9000
"""Scenes from this seed on are for reporting only; they must not be used for tuning."""


def at_least_one(text: str) -> int:
    """Parse an integer argument that must be 1 or more."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f'{number} must be at least 1')
    return number


SHARED: dict[str, dict[str, Any]] = {
    '--data': {'type': Path,
               'default': Path(os.environ.get('PLANE_DETECTOR_DATA', '../shared/data')),
               'help': 'folder of real images, see evaluation/datasets.py; default: '
                       'PLANE_DETECTOR_DATA or %(default)s'},
    '--model': {'default': 'fastdepth', 'help': 'network, as depth.model'},
    '--processes': {'type': at_least_one, 'default': os.cpu_count() or 1},
    '--only-ours': {'action': 'store_true', 'help': 'no other methods'},
    '--scenes': {'type': at_least_one, 'help': 'rendered scenes of each kind'},
    '--rooms': {'type': at_least_one, 'help': 'rooms of boxes'},
    '--living': {'type': at_least_one, 'help': 'lived-in rooms'},
    '--curved': {'type': at_least_one, 'default': 36, 'help': 'curved scenes'},
    '--first-seed': {'type': int, 'default': HELD_OUT,
                     'help': f'of the rendered scenes; those from {HELD_OUT} on were not used for '
                             'tuning'}}


def add_shared(parser: argparse.ArgumentParser, *names: str, **defaults: int) -> None:
    """Declare some of SHARED, with other defaults for some."""
    for name in names:
        parser.add_argument(name, **SHARED[name])
    parser.set_defaults(**defaults)
