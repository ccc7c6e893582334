# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""End of the node program by signals at any time."""

import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

pytest.importorskip('rclpy')


# The signal comes from the thread itself: one from os.kill may reach another thread, and so come
# at a later line.
PROGRAM = """
import signal, sys, time
import rclpy
from rclpy.node import Node
from plane_detector._runtime import ending
from plane_detector.ros.spinning import run

def end():
    signal.raise_signal(signal.{name})

class Dying:
    def __del__(self, end=signal.raise_signal, number=signal.{name}):
        end(number)  # both kept here: the end of the interpreter clears the globals

calls = []

def work():
{work}

def make_node():
    node = Node('node')
    node.create_timer(0.0, work)
    return node

ending.MOST_ENDING_S = {most_ending_s}
run(make_node, [])
"""
STUCK_S = 120.0
# Work in C++ that hears nothing, in a thread of its own or in that of the executor.
LEFT_BEHIND = """
from plane_detector._runtime.stopping import Background
Background(lambda: time.sleep(1000), 'deaf').wait(0.1)
end()
"""
STUCK = 'end(); time.sleep(1000)'


def run_program(program, **variables):
    from ros_helpers import next_domain
    environment = {**os.environ, 'ROS_DOMAIN_ID': str(next_domain()), **variables}
    return subprocess.run([sys.executable, '-c', program], env=environment, capture_output=True,
                          text=True, timeout=STUCK_S, check=False)


def program_of(work, name='SIGTERM', most_ending_s=STUCK_S):
    """Return a program with a node that does this in a callback."""
    return PROGRAM.format(name=name, work=textwrap.indent(work, '    '),
                          most_ending_s=most_ending_s)


def ended(work, name='SIGTERM', with_output=False, **options):
    """Return exit code and output of such a program."""
    done = run_program(program_of(work, name, **options))
    return done.returncode, done.stdout + done.stderr if with_output else done.stderr


def test_a_node_that_cannot_be_made_is_exit_code_1_with_the_reason():
    program = program_of('pass').replace("node = Node('node')", "raise ValueError('a wrong mode')")
    done = run_program(program)
    assert (done.returncode, done.stdout + done.stderr) == (
        1, 'the node cannot start: a wrong mode\n')


def test_without_a_folder_for_logs_the_node_says_how_to_name_one():
    done = run_program(program_of('pass'), HOME='/proc/none', ROS_HOME='', ROS_LOG_DIR='')
    assert done.returncode == 1
    assert 'log directory' in done.stderr
    assert 'name another folder by ROS_LOG_DIR' in done.stderr


@pytest.mark.parametrize(('work', 'name'), [
    ('end()', 'SIGINT'), ('end()', 'SIGTERM'), ('Dying()', 'SIGINT'), (LEFT_BEHIND, 'SIGTERM')],
    ids=['callback, SIGINT', 'callback', 'destructor', 'left behind'])
def test_a_signal_ends_a_working_node_quietly(work, name):
    assert ended(work, name=name) == (0, '')


def test_a_signal_ends_a_node_with_a_blocked_main_thread():
    """Within the time for that."""
    assert ended(STUCK, most_ending_s=1.0) == (128 + signal.SIGTERM, '')


def test_a_second_signal_ends_the_node_at_once():
    work = 'end(); end(); time.sleep(1000)'
    assert ended(work, most_ending_s=1000.0) == (128 + signal.SIGTERM, '')


def test_an_ignored_interrupt_stays_ignored():
    """As under nohup, or of a program that a shell starts in the background."""
    work = ('calls.append(1)\nsignal.raise_signal(signal.SIGINT)\n'
            'if len(calls) == 3:\n    end()')
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # of the child too
    try:
        assert ended(f'print(len(calls) + 1, flush=True)\n{work}', with_output=True) == (
            0, '1\n2\n3\n')
    finally:
        signal.signal(signal.SIGINT, before)


BUG = """
calls.append(1)
if len(calls) == 3:
    end()
raise ValueError("a bug")
"""


def test_an_exception_of_a_callback_is_logged_and_the_node_goes_on():
    code, text = ended(BUG)
    assert code == 0
    assert text.count('error in a callback: ValueError: a bug') == 1  # of three, in an instant
    assert 'in work' in text  # the traceback
    assert 'cannot start' not in text


SHARED_MEMORY = """
text = open('/proc/self/maps').read()
names = {line.split()[-1] for line in text.splitlines() if '/dev/shm/fastrtps_' in line}
print(*(name for name in names if '_port' not in name))
sys.stdout.flush()
end()
"""


def test_the_shared_memory_of_the_middleware_is_released():
    """A segment may be 32 MB, and stays until the machine is started again."""
    # A participant of another program in the same domain has segments mapped here too.
    others = {str(path) for path in Path('/dev/shm').glob('fastrtps_*')}
    done = run_program(program_of(SHARED_MEMORY), RMW_IMPLEMENTATION='rmw_fastrtps_cpp')
    assert done.returncode == 0
    segments = set(done.stdout.split()) - others
    assert segments
    assert not [name for name in segments if os.path.exists(name)]

