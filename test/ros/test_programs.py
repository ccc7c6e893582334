# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Programs that need ROS end at once and quietly: on an interrupt, or without a package."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def missing(name):
    return f'raise ModuleNotFoundError("No module named {name!r}", name={name!r})'


@pytest.mark.parametrize('module, name, text, expected', [
    ('ros.node', 'numba', missing('numba'),
     "No module named 'numba': apt install python3-numba, or pip install 'numba>=0.58'"),
    ('ros.node', 'numba', "raise ImportError('Numba needs NumPy 1.26 or less')",
     'Numba needs NumPy 1.26 or less'),
    ('tools.replay', 'rosbags', missing('rosbags'), "No module named 'rosbags': PIP_BREAK"),
    *((module, 'sitecustomize', "import sys; sys.modules['scipy'] = None",
       '.*scipy.*: apt install python3-scipy, or pip install scipy')
      for module in ('ros.node', 'tools.replay')),
    ('tools.fetch', 'tqdm', missing('tqdm'), "No module named 'tqdm': apt install python3-tqdm"),
    ('tools.show', 'cv2', "raise ImportError('libGL.so.1:\\nno such file', name='cv2')",
     'libGL.so.1: no such file: apt install python3-opencv'),
    ('tools.show', 'rclpy', missing('rclpy'), ".*'rclpy': source /opt/ros/jazzy")])
def test_a_broken_package_ends_the_program_with_the_remedy(module, name, text, expected, tmp_path):
    (tmp_path / f'{name}.py').write_text(text)
    done = subprocess.run(
        [sys.executable, '-m', f'plane_detector.{module}'], cwd=ROOT, capture_output=True,
        text=True, env={**os.environ, 'PYTHONPATH': str(tmp_path)}, check=False)
    assert done.returncode == 1, done.stderr
    assert re.match(expected, done.stderr)
    assert done.stderr.count('\n') == 1


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
                         capture_output=True, text=True, timeout=600)
    assert (run.returncode, run.stdout, run.stderr) == (-signal.SIGINT, '', '')
