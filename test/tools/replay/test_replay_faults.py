# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A replay that is stopped, killed, or fills the disk; damaged messages."""

import signal
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest
from bags import messages_of, write_bag
from diagnostic_msgs.msg import DiagnosticArray
from replay_helpers import (
    DEPTH,
    IMAGE,
    INFO,
    assert_true,
    camera_messages,
    planes_of,
    stamps_of,
)

from plane_detector.ros.frame_processor import FrameProcessor

ROOT = Path(__file__).resolve().parents[3]
# Runs replay with FrameProcessor.process replaced: some code is run before the third frame.
SCRIPT = """
import os, signal, sys, threading, time
from plane_detector._runtime import ending
ending.MOST_ENDING_S = 60.0  # the whole bag, however busy the machine is
from plane_detector.ros.frame_processor import FrameProcessor
process, seen = FrameProcessor.process, []
def counted(self, frame, wanted):
    seen.append(frame)
    if len(seen) == 3:
        {at}
    return process(self, frame, wanted)
FrameProcessor.process = counted
from plane_detector.tools.replay.__main__ import main
sys.exit(main(sys.argv[1:]))
"""


def kill(number):
    """Return code that sends a signal and gives the main thread the time to handle it."""
    return f'os.kill(os.getpid(), {int(number)}); time.sleep(0.5)'


@pytest.fixture
def run(bag, tmp_path):
    """Return a function: replay the bag in a process, with some code before a frame."""
    def run(at, *options):
        return subprocess.run(
            [sys.executable, '-c', SCRIPT.format(at=at), str(bag), str(tmp_path / 'planes'),
             *options], cwd=ROOT, capture_output=True, text=True, timeout=600)
    return run


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_leaves_a_whole_bag_of_the_frames_so_far(bag, scenes, replay, run, tmp_path,
                                                          number):
    table = tmp_path / 'planes.csv'
    ended = run(kill(number), '--csv', str(table))
    assert ended.returncode == 130, ended.stderr
    assert 'Traceback' not in ended.stderr
    assert f'so far are in {tmp_path / "interrupted_planes"}' in ended.stdout
    done = stamps_of(planes_of(tmp_path / 'interrupted_planes'))
    assert done in ([0.0, 0.1], [0.0, 0.1, 0.2])
    assert {path.name for path in tmp_path.iterdir()} == {
        'walk', 'interrupted_planes', 'interrupted_planes.csv'}
    code, target, text = replay(bag)
    assert code == 0, text
    assert_true(target, scenes)


def test_after_a_kill_nothing_has_the_name_and_the_next_run_does_all(
        bag, scenes, replay, run, tmp_path):
    options = ('--csv', str(tmp_path / 'planes.csv'))
    assert run(kill(signal.SIGKILL), *options).returncode == -signal.SIGKILL
    assert {path.name for path in tmp_path.iterdir()} == {
        'walk', '.planes.part', '.planes.csv.part'}
    code, target, text = replay(bag, *options)
    assert code == 0, text
    assert_true(target, scenes)
    assert {path.name for path in tmp_path.iterdir()} == {'walk', 'planes', 'planes.csv'}


def test_an_output_that_exists_is_not_touched(bag, replay, tmp_path):
    (tmp_path / 'planes').symlink_to(tmp_path / 'nowhere')
    code, target, text = replay(bag)
    assert code == 1
    assert text.splitlines()[-1].endswith('already exists: choose another name')
    target.unlink()
    target.mkdir()
    assert replay(bag)[0] == 1
    assert list(target.iterdir()) == []


def in_database(source, *command):
    (file,) = source.glob('*.db3')
    with sqlite3.connect(file) as database:
        return database.execute(*command).fetchall()


def test_an_error_in_one_frame_does_not_end_the_others(bag, replay, monkeypatch):
    seen, process = [], FrameProcessor.process

    def fail_at_third(self, *arguments):
        seen.append(arguments)
        if len(seen) == 3:
            raise IndexError('a bug')
        return process(self, *arguments)
    monkeypatch.setattr(FrameProcessor, 'process', fail_at_third)
    code, target, text = replay(bag)
    assert code == 3, text
    assert '1 frames skipped: IndexError: a bug' in text
    assert stamps_of(planes_of(target)) == [0.0, 0.1, 0.3]


def counts_of(target):
    return [{pair.key: pair.value for pair in msg.status[0].values}['frames_dropped']
            for msg in messages_of(target, '/diagnostics', DiagnosticArray)]


@pytest.mark.parametrize('missing, code, counts', [
    ((0,), 0, ['1', '1', '1']), ((1, 2), 3, ['0', '2']), ((3,), 0, ['0', '0', '0'])])
def test_images_without_depth_are_counted_as_they_come(tmp_path, scenes, replay, missing, code,
                                                       counts):
    """Those at both ends are not missed: recordings begin and end in the middle of a frame."""
    depth_at = [camera_messages(scenes)[3 * index + 2][1] for index in missing]
    messages = [(topic, when, msg) for topic, when, msg in camera_messages(scenes)
                if when not in depth_at]
    found, target, text = replay(write_bag(tmp_path / 'walk', messages))
    assert (found, counts_of(target)) == (code, counts), text
    assert f'{len(missing)} images had no calibration or depth' in text


@pytest.mark.parametrize('topic', [IMAGE, INFO, DEPTH])
def test_a_damaged_message_is_skipped_and_counted(tmp_path, scenes, replay, topic):
    source = write_bag(tmp_path / 'walk', camera_messages(scenes), 'sqlite3')
    rows = in_database(source, 'SELECT id FROM messages WHERE topic_id = (SELECT id FROM topics '
                       'WHERE name = ?) ORDER BY timestamp', (topic,))
    in_database(source, 'UPDATE messages SET data = ? WHERE id = ?',
                (b'\0\1\0\0\xff\xff', rows[0][0]))
    code, target, text = replay(source)
    assert code == 3, text
    assert '1 damaged messages were skipped' in text
    # the calibration of another image serves
    assert stamps_of(planes_of(target)) == [0.0] * (topic == INFO) + [0.1, 0.2, 0.3]
