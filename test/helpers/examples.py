# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The modules whose docstrings have examples, and their run."""

import doctest
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
NEED_ROS = ('plane_detector.ros.', 'plane_detector.tools.')


def modules_with_examples(needs_ros: bool) -> list[str]:
    """Return the names of the modules that have examples, of the core or of all else."""
    names = ('.'.join(path.relative_to(ROOT).with_suffix('').parts).removesuffix('.__init__')
             for path in (ROOT / 'plane_detector').rglob('*.py')
             if '>>> ' in path.read_text(encoding='utf-8'))
    return sorted(name for name in names if name.startswith(NEED_ROS) == needs_ros)


def failures_in(name: str) -> int:
    """Run the examples of a module, which has some; return how many fail."""
    result = doctest.testmod(import_module(name), optionflags=FLAGS)
    assert result.attempted > 0
    return result.failed
