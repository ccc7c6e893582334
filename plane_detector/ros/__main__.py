# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The program of the node, `python3 -m plane_detector.ros`, that takes signals from the start."""

from __future__ import annotations

import signal
import sys


def main() -> int:
    """Run the node until SIGINT or SIGTERM; return the exit code."""
    # The imports take a second, in which SIGINT would give a traceback from anywhere in them.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    from plane_detector.ros.node import main as run_node
    return run_node()


if __name__ == '__main__':
    sys.exit(main())
