# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Many bags: search, names, a second run, a bag that fails, a worker that dies."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import joblib
import pytest
from bags import read_bag, write_bag
from replay_helpers import DEPTH, assert_true, camera_messages, rows_of

from plane_detector.tools.replay import many_bags
from plane_detector.tools.replay.__main__ import main
from plane_detector.tools.replay.bag_reader import BagError
from plane_detector.tools.replay.many_bags import BagSummary, find_bags, is_collection

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def bags(tmp_path, scenes):
    """Return a folder of three bags, one of them in a subfolder."""
    folder = tmp_path / 'bags'
    (folder / 'monday').mkdir(parents=True)
    for name in ('first', 'second', 'monday/walk'):
        write_bag(folder / name, camera_messages(scenes), 'sqlite3')
    return folder


def summary_of(folder):
    return {row['bag']: row for row in rows_of(folder / 'summary.csv')}


def plane_topics(bag):
    """Return all that is the same in every run: the diagnostics hold times."""
    return {topic: messages for topic, messages in read_bag(bag).items()
            if topic != '/diagnostics'}


def test_bags_are_found_in_folders_and_by_patterns(bags):
    assert list(find_bags([str(bags)])) == ['first', 'monday_walk', 'second']
    assert find_bags([str(bags / 's*')]) == {'second': bags / 'second'}
    assert find_bags([str(bags / 'first'), str(bags / 'monday')]) == {
        'first': bags / 'first', 'walk': bags / 'monday' / 'walk'}
    assert list(find_bags([str(bags)], left_out=bags / 'monday')) == ['first', 'second']
    (bags / '.second.part').mkdir()
    (bags / 'first').rename(bags / '.second.part' / 'second')
    assert list(find_bags([str(bags)])) == ['monday_walk', 'second']
    assert [is_collection(str(path)) for path in (bags, bags / 'second', bags / '*')] == [
        True, False, True]


def test_folder_names_keep_their_dots(bags, scenes, tmp_path, monkeypatch):
    for name in ('v1.1', 'v1.2', 'monday/v1.3'):
        write_bag(bags / name, camera_messages(scenes[:1]))
    assert list(find_bags([str(bags)])) == ['first', 'monday_v1.3', 'monday_walk', 'second',
                                            'v1.1', 'v1.2']
    assert list(find_bags([str(bags / 'v1.1'), str(bags / 'v1.2')])) == ['v1.1', 'v1.2']
    monkeypatch.chdir(tmp_path)
    assert main([str(bags / 'v1.1'), '--depth', DEPTH]) == 0
    assert_true(tmp_path / 'v1.1_planes', scenes[:1])


def test_missing_bags_and_equal_names_are_reported(bags, scenes):
    with pytest.raises(FileNotFoundError, match='there is no bag at'):
        find_bags([str(bags / 'third*')])
    (bags / 'empty').mkdir()
    with pytest.raises(FileNotFoundError, match='there is no bag in'):
        find_bags([str(bags / 'empty')])
    write_bag(bags / 'monday_walk', camera_messages(scenes[:1]))
    with pytest.raises(BagError, match='would both become monday_walk'):
        find_bags([str(bags)])


def test_one_run_a_second_one_and_one_that_fails(bags, scenes, tmp_path, capsys, replay):
    """The result is byte for byte that of a single bag; a second run does what is missing."""
    out = tmp_path / 'out'
    (bags / 'broken.mcap').write_bytes(b'no bag')
    assert main([str(bags), str(out), '--jobs', '2']) == 1
    table = capsys.readouterr().out
    rows = summary_of(out)
    assert [row['state'] for row in rows.values()] == ['failed', *['finished'] * 3]
    assert 'cannot be read' in rows['broken']['error']
    assert {row['frames'] for row in rows.values()} == {'0', str(len(scenes))}
    assert '4 bags, 12 frames: 1 failed, 3 finished' in table
    assert sorted(path.name for path in out.iterdir()) == [
        'first', 'monday_walk', 'second', 'summary.csv']
    _, alone, _ = replay(bags / 'first', depth='')
    for name in ('first', 'second', 'monday_walk'):
        assert_true(out / name, scenes)
        assert plane_topics(out / name) == plane_topics(alone)
    (bags / 'broken.mcap').unlink()
    (out / 'second').rename(out / '.second.part')  # as a killed run leaves it
    before = (out / 'first' / 'metadata.yaml').stat().st_mtime_ns
    assert main([str(bags), str(out), '--jobs', '1']) == 0
    rows = summary_of(out)
    assert {name: row['state'] for name, row in rows.items()} == {
        'first': 'done before', 'monday_walk': 'done before', 'second': 'finished'}
    assert {row['frames'] for row in rows.values()} == {str(len(scenes))}
    assert (out / 'first' / 'metadata.yaml').stat().st_mtime_ns == before


def test_the_jobs_run_where_joblib_is_set(bags, tmp_path, monkeypatch):
    """As on a cluster; here in this process, where the stand-in for the work is seen."""
    done = []

    def count(options):
        done.append(options.target.name)
        return BagSummary(options.target.name, 'finished')
    monkeypatch.setattr(many_bags, 'replay_one', count)
    with joblib.parallel_config('sequential'):
        assert main([str(bags), str(tmp_path / 'out')]) == 0
    assert done == ['first', 'monday_walk', 'second']


def start(bags, out):
    return subprocess.Popen(
        [sys.executable, '-m', 'plane_detector.tools.replay', '--jobs', '2',
         '--output-folder', str(out), str(bags)], cwd=ROOT, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, start_new_session=True)


def wait_for(condition):
    deadline_s = time.monotonic() + 600
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.02)


def workers_of(process):
    """Return the processes of the pool."""
    found = []
    for path in Path('/proc').glob('[0-9]*/stat'):
        try:
            parent = int(path.read_text().rpartition(')')[2].split()[1])
            command = (path.parent / 'cmdline').read_text()
        except OSError:
            continue
        if parent == process.pid and 'popen_loky' in command:
            found.append(int(path.parent.name))
    return found


def test_after_a_signal_or_a_killed_worker_the_same_command_does_the_rest(bags, scenes, tmp_path):
    out = tmp_path / 'out'

    def interrupted(by):
        with start(bags, out) as process:
            wait_for(lambda: workers_of(process) or process.poll() is not None)
            by(process)
            _, printed = process.communicate()
        assert not workers_of(process)
        return process.returncode, printed

    code, _ = interrupted(lambda process: os.killpg(process.pid, signal.SIGINT))  # Ctrl-C
    assert code == 130
    code, text = interrupted(lambda process: os.kill(workers_of(process)[0], signal.SIGKILL))
    assert code == 1
    assert 'a worker ended, at one of' in text
    assert 'Traceback' not in text
    assert main([str(bags), str(out), '--jobs', '1']) == 0
    for name in ('first', 'second', 'monday_walk'):
        assert_true(out / name, scenes)
    assert not list(out.glob('.*.part'))
