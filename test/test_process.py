# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""How the program of the node ends, whatever a signal meets it at."""

import subprocess
import sys

import pytest

pytest.importorskip('rclpy')

PROGRAM = """
import os, signal, sys
from plane_detector.ros.process import run

def make_node():
    try:
        {before}
    except KeyboardInterrupt:
        raise RuntimeError('what C makes of it') from None
    raise {error}

sys.exit(run(make_node, []))
"""
SIGNAL = 'os.kill(os.getpid(), signal.{})'


def end(before, error='ValueError("too large")'):
    """Return exit code and output of a program whose node cannot be made."""
    done = subprocess.run([sys.executable, '-c', PROGRAM.format(before=before, error=error)],
                          capture_output=True, text=True, timeout=60, check=False)
    return done.returncode, done.stderr


@pytest.mark.parametrize('name', ['SIGINT', 'SIGTERM'])
def test_an_interrupt_within_c_ends_quietly(name):
    code, text = end(SIGNAL.format(name))
    assert (code, 'Traceback' in text) == (0, False)


def test_wrong_settings_are_told():
    code, text = end('pass')
    assert code == 1
    assert 'the node cannot start: too large' in text
    assert 'Traceback' not in text


def test_other_errors_keep_their_traceback():
    code, text = end('pass', 'RuntimeError("a bug")')
    assert code == 1
    assert 'Traceback' in text
    assert 'a bug' in text
