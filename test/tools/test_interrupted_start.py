# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""SIGINT while a program imports its modules."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = """
import os, runpy, signal, sys
class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == 'rclpy':
            os.kill(os.getpid(), signal.SIGINT)
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Interrupting())
sys.argv[1:] = []
runpy.run_module({!r}, run_name='__main__', alter_sys=True)
"""


@pytest.mark.parametrize('module', [
    'plane_detector.ros.node', 'plane_detector.tools.replay', 'plane_detector.tools.demo',
    'plane_detector.tools.show'])
def test_an_interrupt_during_the_imports_ends_the_program_quietly(module):
    run = subprocess.run([sys.executable, '-c', SCRIPT.format(module)], cwd=ROOT,
                         capture_output=True, text=True, timeout=120)
    assert (run.returncode, run.stdout, run.stderr) == (-signal.SIGINT, '', '')
