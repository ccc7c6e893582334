# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A replay that is interrupted, killed, or fills the disk; a damaged bag."""

import resource
import signal
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest
from bags import read_bag, write_bag
from replay_helpers import (
    DEPTH,
    IMAGE,
    INFO,
    assert_true,
    camera_messages,
    planes_of,
    stamps_of,
)
from sensor_msgs.msg import PointCloud2

from plane_detector.ros.frame_processor import FrameProcessor
from plane_detector.tools.replay.bag_reader import BagReader, to_message
from plane_detector.tools.replay.bag_salvage import salvage

ROOT = Path(__file__).resolve().parents[3]
COMMAND = [sys.executable, '-m', 'plane_detector.tools.replay']


@pytest.fixture
def kill_at(tmp_path):
    """Return a function: replay a bag in a process that ends itself at a frame, by a signal."""
    def run(source, frame, number, *options):
        script = (
            'import os, sys\n'
            'from plane_detector.ros.frame_processor import FrameProcessor\n'
            'from plane_detector.tools.replay import bag_writer\n'
            'bag_writer._COMMIT_BYTES = 1\n'
            'process, count = FrameProcessor.process, 0\n'
            'def counted(self, frame, wanted):\n'
            '    global count\n'
            '    count += 1\n'
            f'    if count == {frame + 1}:\n'
            f'        os.kill(os.getpid(), {int(number)})\n'
            '    return process(self, frame, wanted)\n'
            'FrameProcessor.process = counted\n'
            'from plane_detector.tools.replay.program import main\n'
            'sys.exit(main(sys.argv[1:]))\n')
        return subprocess.run(
            [sys.executable, '-c', script, str(source), str(tmp_path / 'planes'), *options],
            cwd=ROOT, capture_output=True, text=True, timeout=120)
    return run


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_killed_replay_keeps_its_frames_and_can_be_resumed(
        bag, scenes, replay, kill_at, tmp_path, storage):
    options = ('--storage', storage, '--copy')
    assert kill_at(bag, 2, signal.SIGKILL, *options).returncode == -signal.SIGKILL
    part = tmp_path / 'planes.part' / 'planes'
    assert not (tmp_path / 'planes').exists()
    code, _, text = replay(bag, *options)
    assert code == 1
    assert '--resume continues it, or remove it' in text
    assert salvage(part)
    with BagReader(part) as left:
        assert stamps_of(to_message(r, PointCloud2) for r in left.read(
            ['/plane_detector/planes'])) == [0.0, 0.1]
    code, target, text = replay(bag, *options, '--resume')
    assert code == 0, text
    assert_true(target, scenes)
    source, copied = read_bag(bag), read_bag(target)
    assert {topic: copied[topic] for topic in source} == source
    assert not part.parent.exists()


def test_the_table_is_resumed_too(bag, replay, kill_at, tmp_path):
    table = tmp_path / 'planes.csv'
    kill_at(bag, 2, signal.SIGKILL, '--csv', str(table))
    code, _, text = replay(bag, '--csv', table, '--resume')
    assert code == 0, text
    frames = [int(line.split(',')[0]) for line in table.read_text().splitlines()[1:]]
    assert sorted(set(frames)) == [0, 1, 2, 3]
    assert frames == sorted(frames)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_leaves_a_complete_bag_that_can_be_resumed(
        bag, scenes, replay, kill_at, tmp_path, number):
    run = kill_at(bag, 2, number)
    assert run.returncode == 130, run.stderr
    assert 'Traceback' not in run.stderr
    done = stamps_of(planes_of(tmp_path / 'planes'))
    assert done in ([0.0, 0.1], [0.0, 0.1, 0.2])
    code, _, text = replay(bag)
    assert code == 1
    assert 'not finished: --resume continues it' in text
    code, target, text = replay(bag, '--resume')
    assert code == 0, text
    assert_true(target, scenes)
    code, _, text = replay(bag, '--resume')
    assert code == 1
    assert 'already exists' in text


def test_an_endless_frame_does_not_delay_the_end(bag, tmp_path):
    script = (
        'import sys, threading\n'
        'from plane_detector.ros.frame_processor import FrameProcessor\n'
        'process = FrameProcessor.process\n'
        'def hangs(self, frame, wanted):\n'
        '    if frame.image.header.stamp.nanosec:\n'
        '        print("hangs", flush=True)\n'
        '        threading.Event().wait()\n'
        '    return process(self, frame, wanted)\n'
        'FrameProcessor.process = hangs\n'
        'from plane_detector.tools.replay.program import main\n'
        'sys.exit(main(sys.argv[1:]))\n')
    with subprocess.Popen(
            [sys.executable, '-c', script, str(bag), str(tmp_path / 'planes')], cwd=ROOT,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == 'hangs\n'
        process.send_signal(signal.SIGTERM)
        printed = process.communicate(timeout=60)
    assert process.returncode == 130, printed
    assert 'Traceback' not in printed[1]
    assert stamps_of(planes_of(tmp_path / 'planes')) == [0.0]


def test_two_processes_do_not_write_the_same_bag(bag, replay, monkeypatch, tmp_path):
    """The second one starts while the first is at its first frame."""
    process, seen = FrameProcessor.process, []

    def second(self, frame, wanted):
        if not seen:
            seen.append(subprocess.run(
                [*COMMAND, str(bag), str(tmp_path / 'planes'), '--resume'], cwd=ROOT,
                capture_output=True, text=True, timeout=120))
        return process(self, frame, wanted)

    monkeypatch.setattr(FrameProcessor, 'process', second)
    assert replay(bag)[0] == 0
    assert seen[0].returncode == 1
    assert 'is being written by another process' in seen[0].stderr


def limit_file_size(size):
    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
    return limit


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_full_disk_leaves_the_frames_before(bag, tmp_path, storage):
    """The limit takes the place of the disk: of four frames some fit."""
    room = 3_000_000 if storage == 'mcap' else 2_000_000
    script = ('import sys\nfrom plane_detector.tools.replay import bag_writer\n'
              'bag_writer._COMMIT_BYTES = 1\n'
              'from plane_detector.tools.replay.program import main\n'
              'sys.exit(main(sys.argv[1:]))\n')
    run = subprocess.run(
        [sys.executable, '-c', script, str(bag), str(tmp_path / 'planes'), '--storage', storage],
        cwd=ROOT, capture_output=True, text=True, timeout=120,
        preexec_fn=limit_file_size(room))
    assert run.returncode == 1, run.stdout + run.stderr
    assert 'Traceback' not in run.stderr
    assert 'cannot be written: ' in run.stderr.splitlines()[-1]
    done = stamps_of(planes_of(tmp_path / 'planes'))
    assert 1 <= len(done) < 4
    assert done == [0.0, 0.1, 0.2][:len(done)]


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_disk_too_full_for_the_first_frame_is_reported_in_a_line(bag, tmp_path, storage):
    run = subprocess.run(
        [sys.executable, '-m', 'plane_detector.tools.replay', str(bag), str(tmp_path / 'planes'),
         '--storage', storage], cwd=ROOT, capture_output=True, text=True, timeout=120,
        preexec_fn=limit_file_size(1_200_000))
    assert run.returncode == 1, run.stdout + run.stderr
    assert 'Traceback' not in run.stderr
    assert 'cannot be written: ' in run.stderr.splitlines()[-1]


def test_figures_into_a_place_that_cannot_be_written(bag, replay, tmp_path):
    (tmp_path / 'file').write_text('')
    for place in (tmp_path / 'file', tmp_path / 'file' / 'folder', Path('/proc/figures')):
        code, target, text = replay(bag, '--figures', place)
        assert code == 1
        assert text.splitlines()[-1].startswith('replay: ')
        assert 'Traceback' not in text
        assert not target.exists()
        assert not target.with_name('planes.part').exists()


def test_a_failure_to_write_figures_ends_the_replay(bag, replay, tmp_path, monkeypatch):
    monkeypatch.setattr('cv2.imwrite', lambda path, image: '000001' not in path)
    code, target, text = replay(bag, '--figures', tmp_path / 'figures')
    assert code == 1
    assert '000001.jpg cannot be written' in text
    assert stamps_of(planes_of(target)) == [0.0]


def test_a_dangling_link_as_output_is_reported(bag, replay, tmp_path):
    (tmp_path / 'planes').symlink_to(tmp_path / 'nowhere')
    code, _, text = replay(bag)
    assert code == 1
    assert text.splitlines()[-1].endswith('already exists: choose another name')


@pytest.mark.parametrize('topic, told', [
    (IMAGE, 'no topic for --image was found, and no message is recorded on '
            '/cam/image_raw'),
    (INFO, 'and no message is recorded on /cam/camera_info')])
def test_announced_but_missing_messages_are_reported(tmp_path, scenes, replay, topic, told):
    source = write_bag(tmp_path / 'walk', camera_messages(scenes), 'sqlite3')
    (file,) = source.glob('*.db3')
    with sqlite3.connect(file) as database:
        database.execute('DELETE FROM messages WHERE topic_id = '
                         '(SELECT id FROM topics WHERE name = ?)', (topic,))
    code, target, text = replay(source)
    assert (code, target.exists()) == (1, False)
    assert told in text
    assert 'Traceback' not in text


@pytest.mark.parametrize('topic', [IMAGE, INFO, DEPTH])
@pytest.mark.parametrize('index', [0, 2])
def test_a_damaged_message_is_skipped_and_counted(tmp_path, scenes, replay, topic, index):
    source = write_bag(tmp_path / 'walk', camera_messages(scenes), 'sqlite3')
    (file,) = source.glob('*.db3')
    with sqlite3.connect(file) as database:
        rows = database.execute('SELECT id FROM messages WHERE topic_id = (SELECT id FROM topics '
                                'WHERE name = ?) ORDER BY timestamp', (topic,)).fetchall()
        database.execute('UPDATE messages SET data = ? WHERE id = ?', (b'\0\1\0\0\xff\xff',
                                                                      rows[index][0]))
    code, target, text = replay(source)
    assert code == 3, text
    assert '1 damaged messages were skipped' in text
    stamps = [0.0, 0.1, 0.2, 0.3]
    if topic != INFO:  # the calibration of another image serves
        del stamps[index]
    assert stamps_of(planes_of(target)) == stamps


def test_damaged_compressed_messages_are_skipped(tmp_path, scenes, replay):
    """The library that unpacks them gives up at the first; reading begins anew after it."""
    source = write_bag(tmp_path / 'walk', camera_messages(scenes), 'sqlite3_zstd_messages')
    (file,) = source.glob('*.db3')
    with sqlite3.connect(file) as database:
        (identity,) = database.execute('SELECT id FROM messages ORDER BY timestamp '
                                       'LIMIT 1 OFFSET 6').fetchone()
        database.execute('UPDATE messages SET data = ? WHERE id = ?', (b'garbage', identity))
    code, target, text = replay(source)
    assert code == 3, text
    assert stamps_of(planes_of(target)) == [0.0, 0.1, 0.3]


def test_a_kill_leaves_only_complete_frames(bag, kill_at, tmp_path):
    """All topics have the same stamps: commits come between frames."""
    kill_at(bag, 3, signal.SIGKILL)
    part = tmp_path / 'planes.part' / 'planes'
    assert salvage(part)
    with BagReader(part) as left:
        counts = {topic.name: topic.count for topic in left.topics if topic.count}
    assert set(counts.values()) == {3}
