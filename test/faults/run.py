# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Faults on purpose, and what becomes of the node and the programs: a table as Markdown.

Started by `make faults`. The exit code is 1 when a row is not as it should be.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import cv2
import onnxruntime
from common import Row, table
from disk import replays
from fields import fields
from maps import maps
from soak import soak

from plane_detector.evaluation.benchmark.report import commit, machine

GROUPS = {'fields': fields, 'maps': maps, 'replays': replays}


def main() -> int:
    """Run the requested groups; print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--only', nargs='*', choices=list(GROUPS), default=list(GROUPS))
    parser.add_argument('--soak-minutes', type=int, default=0, metavar='N',
                        help='run for so long at 30 Hz, at least 3; this alone with --only')
    options = parser.parse_args()
    print(f'`make faults` ({" ".join(sys.argv[1:]) or "no options"}); {machine()}, OpenCV '
          f'{cv2.__version__}, ONNX Runtime {onnxruntime.__version__}; commit {commit()}\n',
          flush=True)
    rows: list[Row] = []
    with tempfile.TemporaryDirectory(prefix='plane_detector_faults_') as folder:
        for name in options.only:
            start_s = time.monotonic()
            rows += GROUPS[name](Path(folder))
            print(f'{name}: {time.monotonic() - start_s:.0f} s', file=sys.stderr, flush=True)
        if options.soak_minutes:
            rows += soak(Path(folder), max(options.soak_minutes, 3))
    print(f'\n{table(rows)}')
    return not all(row.good for row in rows)


if __name__ == '__main__':
    sys.exit(main())
