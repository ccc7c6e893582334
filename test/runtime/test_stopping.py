# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Stopping of work, and processes that exit despite work that does not stop or imports."""

import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from plane_detector._runtime.ending import run_program
from plane_detector._runtime.stopping import Stop, Stopped, raise_if_stopped

ROOT = Path(__file__).resolve().parents[2]
STUCK_S = 120.0


def test_a_stop_applies_within_only():
    stop = Stop()
    stop.set()
    with pytest.raises(Stopped), stop.applies():
        raise_if_stopped()
    raise_if_stopped()


def test_the_callback_is_called_once_and_only_while_the_work_runs():
    stop, called = Stop(), []
    with stop.calling(lambda: called.append('before')):
        pass
    with stop.calling(lambda: called.append('during')):
        stop.set()
        stop.set()
    assert called == ['during']
    with pytest.raises(Stopped), stop.calling(lambda: called.append('after')):
        called.append('begun')
    assert called == ['during']


def test_an_uncut_block_is_completed_before_the_stop():
    stop, begun, free, done = Stop(), threading.Event(), threading.Event(), []

    def whole():
        with stop.uncut():
            begun.set()
            assert free.wait(STUCK_S)
            done.append('whole')

    writer = threading.Thread(target=whole)
    writer.start()
    assert begun.wait(STUCK_S)
    setter = threading.Thread(target=lambda: (stop.set(), done.append('stopped')))
    setter.start()
    setter.join(0.1)
    assert not stop.is_set
    free.set()
    setter.join(STUCK_S)
    assert done == ['whole', 'stopped']
    with pytest.raises(Stopped), stop.uncut():
        done.append('again')


@pytest.mark.parametrize('work', ['time.sleep(1000)', 'None'], ids=['deaf', 'done'])
def test_a_process_exits_despite_work_that_ignores_the_stop(work):
    program = f"""
import sys, time
from plane_detector._runtime.ending import leave
from plane_detector._runtime.ending import run_program
from plane_detector._runtime.stopping import Background
call = Background(lambda: {work}, 'work')
call.wait(0.2)
print('whole', end='')
sys.exit(leave(3))
"""
    done = subprocess.run([sys.executable, '-c', program], cwd=ROOT, timeout=STUCK_S,
                          capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (3, 'whole', '')


@pytest.mark.parametrize('ignored', [False, True])
def test_a_signal_ends_a_program_whose_main_thread_hears_nothing(ignored):
    """But not one that is ignored, as SIGINT under nohup."""
    program = f"""
import signal, time
from plane_detector._runtime import ending
ending.MOST_ENDING_S = 0.1
signal.signal(signal.SIGINT, signal.SIG_IGN if {ignored} else signal.default_int_handler)

def work():
    for number, pause_s in ((signal.SIGINT, 1), (signal.SIGTERM, 1000)):
        signal.raise_signal(number)
        time.sleep(pause_s)

ending.until_signal(work)
"""
    done = subprocess.run([sys.executable, '-c', program], cwd=ROOT, timeout=STUCK_S,
                          capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (
        128 + (signal.SIGTERM if ignored else signal.SIGINT), '', '')


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_process_whose_interpreter_hangs_ends_after_a_signal(number):
    """An endless loop in C keeps the interpreter's lock: no handler and no other thread runs."""
    program = """
import collections, itertools
from plane_detector._runtime import ending
ending.MOST_ENDING_S = ending.KILLED_LATER_S = 0.5

def work():
    print('hangs', flush=True)
    collections.deque(itertools.repeat(None), maxlen=0)

ending.until_signal(work)
"""
    with subprocess.Popen([sys.executable, '-c', program], cwd=ROOT, text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        try:
            assert process.stdout.readline() == 'hangs\n'
            process.send_signal(number)
            assert process.communicate(timeout=STUCK_S) == (
                '', 'the process has not ended after a signal: it is killed\n')
        finally:
            process.kill()
    assert process.returncode == -signal.SIGKILL


def test_slow_work_that_heeds_the_signal_ends_by_itself():
    """It takes longer than the guard waits, without a signal; then it ends, and the guard too."""
    program = """
import os, time
from plane_detector._runtime import ending
from plane_detector._runtime.stopping import raise_if_stopped, Stopped
ending.MOST_ENDING_S, ending.KILLED_LATER_S = 3.0, 0.0

def work():
    time.sleep(3.5)
    print('slow', flush=True)
    while True:
        raise_if_stopped()

try:
    ending.until_signal(work)
except Stopped:
    try:
        os.waitpid(-1, os.WNOHANG)
    except ChildProcessError:
        print('ended, no child is left')
"""
    with subprocess.Popen([sys.executable, '-c', program], cwd=ROOT, text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        try:
            assert process.stdout.readline() == 'slow\n'
            process.send_signal(signal.SIGTERM)
            assert process.communicate(timeout=STUCK_S) == ('ended, no child is left\n', '')
        finally:
            process.kill()
    assert process.returncode == 0


def test_an_error_that_quotes_data_cannot_drive_the_terminal(capsys):
    def fail():
        raise ValueError('a bag with a topic called \x1b[2J\nand more')
    assert run_program('replay', fail) == 1
    assert capsys.readouterr().err == (
        'replay: a bag with a topic called \\x1b[2J\nand more\n')
