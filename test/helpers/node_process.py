# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The node as a separate process."""

import os
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
STARTED_S = 60.0


class NodeProcess:
    """The node with these arguments, and what it printed."""

    def __init__(self, arguments, domain, log_path):
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain), 'PYTHONUNBUFFERED': '1',
                       'PYTHONPATH': str(ROOT)}
        self._log_path = log_path
        with open(log_path, 'wb') as log:
            self.process = subprocess.Popen(
                [sys.executable, '-m', 'plane_detector.ros.node', '--ros-args', *arguments],
                env=environment, cwd=log_path.parent, stdout=log, stderr=subprocess.STDOUT)

    def log(self):
        return self._log_path.read_text(errors='replace')

    def wait_until(self, condition):
        end_s = time.monotonic() + STARTED_S
        while not condition():
            assert time.monotonic() < end_s, self.log()
            time.sleep(0.01)

    def end(self, number):
        """Send a signal and return the exit code."""
        self.process.send_signal(number)
        return self.process.wait(STARTED_S)
