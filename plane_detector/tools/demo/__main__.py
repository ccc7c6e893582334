# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The program `demo`, also `python3 -m plane_detector.tools.demo`."""

import sys

from plane_detector.dependencies import explained_imports
from plane_detector.stopping import quiet_interrupt

with quiet_interrupt(), explained_imports('numba'):
    from plane_detector.tools.demo.command_line import main

if __name__ == '__main__':
    sys.exit(main())
