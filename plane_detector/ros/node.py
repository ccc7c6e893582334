# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The program `node`, also `python3 -m plane_detector.ros.node`; takes signals from the start."""

from __future__ import annotations

import signal
import sys


def main(args: list[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; return the exit code."""
    # The imports take a second, in which SIGINT would give a traceback from anywhere in them.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    from plane_detector.ros.lifecycle_node import PlaneDetectorNode
    from plane_detector.ros.spinning import run
    return run(PlaneDetectorNode, args)


if __name__ == '__main__':
    sys.exit(main())
