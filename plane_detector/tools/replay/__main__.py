# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The program `replay`, also `python3 -m plane_detector.tools.replay`."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from plane_detector.dependencies import explained_imports
from plane_detector.stopping import quiet_interrupt


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; return the exit code."""
    with quiet_interrupt(), explained_imports('numba'):
        from plane_detector.tools.replay import command_line
    return command_line.main(arguments)


if __name__ == '__main__':
    sys.exit(main())
