# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Many bags: search, names, a second run, a bag that fails, a worker that dies."""

import csv
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from bags import read_bag, write_bag
from replay_helpers import DEPTH, assert_true, camera_messages
from tqdm import tqdm

from plane_detector.tools.replay import many
from plane_detector.tools.replay.arguments import parse
from plane_detector.tools.replay.bag_reader import BagError
from plane_detector.tools.replay.find_bags import find_bags, is_collection
from plane_detector.tools.replay.one_bag import (
    STOP_FILE,
    BagSummary,
    read_summary,
    replay_bag,
    write_summary,
)
from plane_detector.tools.replay.options import ReplayOptions
from plane_detector.tools.replay.part_folder import FINISHED, STATE, replay_fields
from plane_detector.tools.replay.program import main

ROOT = Path(__file__).resolve().parents[3]
PLANES = '/plane_detector/planes'


@pytest.fixture
def bags(tmp_path, scenes):
    """Return a folder of three bags, one of them in a subfolder."""
    folder = tmp_path / 'bags'
    (folder / 'monday').mkdir(parents=True)
    for name in ('first', 'second', 'monday/walk'):
        write_bag(folder / name, camera_messages(scenes), 'sqlite3')
    return folder


def rows_of(folder):
    with open(folder / 'summary.csv', encoding='utf-8') as file:
        return {row['bag']: row for row in csv.DictReader(file)}


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
    assert [is_collection(str(path)) for path in (bags, bags / 'first', bags / '*')] == [
        True, False, True]


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
    """The result is byte for byte that of a single bag."""
    out = tmp_path / 'out'
    (bags / 'broken.mcap').write_bytes(b'no bag')
    assert main([str(bags), str(out), '--jobs', '2']) == 1
    table = capsys.readouterr().out
    rows = rows_of(out)
    assert [row['state'] for row in rows.values()] == ['failed', *[FINISHED] * 3]
    assert 'cannot be read' in rows['broken']['error']
    assert {row['frames'] for row in rows.values()} == {'0', str(len(scenes))}
    assert '4 bags, 12 frames: 1 failed, 3 finished' in table
    assert sorted(path.name for path in out.iterdir()) == [
        'first', 'monday_walk', 'second', 'summary.csv']
    _, alone, _ = replay(bags / 'first', depth='')
    for name in ('first', 'second', 'monday_walk'):
        assert_true(out / name, scenes)
        assert plane_topics(out / name) == plane_topics(alone)
    before = (out / 'first' / 'metadata.yaml').stat().st_mtime_ns
    (bags / 'broken.mcap').unlink()
    assert main([str(bags), str(out), '--jobs', '2']) == 0
    assert {row['state'] for row in rows_of(out).values()} == {'done before'}
    assert (out / 'first' / 'metadata.yaml').stat().st_mtime_ns == before


def test_the_progress_ends_with_all_bags_and_frames(bags, scenes, tmp_path, monkeypatch):
    shown = []

    class Bar(tqdm):
        def set_postfix_str(self, text):
            shown.append((self.n, self.total, text))

    monkeypatch.setattr(many, 'tqdm', Bar)
    assert main([str(bags / 'first'), str(bags / 'second'), str(tmp_path / 'out'),
                 '--outputs', 'planes']) == 0
    assert shown[-1] == (2, 2, f'{2 * len(scenes)} frames')


def test_a_bag_with_other_options_is_not_treated_as_finished(bag, tmp_path):
    def options(**changes):
        return ReplayOptions(source=bag, target=tmp_path / 'out', depth_by_bag=True,
                             leftover='restart', **changes)

    assert replay_bag(options(), tmp_path).state == FINISHED
    summary = replay_bag(options(every=2), tmp_path)
    assert summary.state == 'failed'
    assert 'with other options' in summary.error
    assert replay_bag(options(), tmp_path).state == 'done before'
    assert read_summary('out', tmp_path).frames == 4


def test_an_unfinished_bag_is_restarted_and_gives_the_same(bag, tmp_path):
    """A file for stopping ends the first try; the second has all frames, and their bytes."""
    options = ReplayOptions(source=bag, target=tmp_path / 'out', depth_by_bag=True,
                            leftover='restart')
    (tmp_path / STOP_FILE).touch()
    assert replay_bag(options, tmp_path).state == 'interrupted'
    (tmp_path / STOP_FILE).unlink()
    part = tmp_path / 'out.part' / 'out'
    part.mkdir(parents=True)
    (part / 'out.mcap').write_bytes(b'of a killed worker')
    summary = replay_bag(options, tmp_path)
    assert (summary.state, summary.frames) == (FINISHED, 4)
    assert not part.parent.exists()
    assert replay_fields(options.target)[STATE] == FINISHED


def start(bags, out, *options):
    return subprocess.Popen(
        [sys.executable, '-m', 'plane_detector.tools.replay', '--jobs', '2', *options,
         '--output-folder', str(out), str(bags)], cwd=ROOT, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True)


def wait_for(condition):
    deadline_s = time.monotonic() + 120
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


def test_a_signal_ends_all_and_a_second_run_with_a_killed_worker_does_the_rest(
        bags, scenes, tmp_path):
    out = tmp_path / 'out'
    with start(bags, out) as process:
        wait_for(lambda: any(out.glob('*.part')) or process.poll() is not None)
        process.send_signal(signal.SIGTERM)
        printed = process.communicate()
    assert process.returncode == 130, printed
    assert 'Traceback' not in printed[1]
    assert 'interrupted' in printed[0]
    with start(bags, out) as process:
        wait_for(lambda: any(out.glob('*.part')) or process.poll() is not None)
        workers = workers_of(process)
        os.kill(workers[0], signal.SIGKILL)
        printed = process.communicate()
    assert process.returncode == 0, printed
    for name in ('first', 'second', 'monday_walk'):
        assert_true(out / name, scenes)
    assert not list(out.glob('*.part'))


def test_a_bag_that_ends_its_workers_fails_and_the_others_are_done(tmp_path, monkeypatch):
    """It is tried twice beside the others, whose workers end with it, then alone."""
    rounds = []

    def one_round(batch, run_folder, _ahead):
        rounds.append([job.target.name for job in batch])
        if 'bad' in rounds[-1]:
            return 'the worker ended'
        for job in batch:
            write_summary(BagSummary(job.target.name, FINISHED, frames=4), run_folder)
        return ''

    monkeypatch.setattr(many, '_one_round', one_round)
    jobs = many.make_jobs({'bad': Path('bad'), 'good': Path('good')}, tmp_path,
                          ReplayOptions(Path(), tmp_path))
    bad, good = many.replay_many(jobs, tmp_path, many.Pool(), lambda: False)
    assert sorted(rounds) == [['bad'], ['bad', 'good'], ['bad', 'good'], ['good']]
    assert (bad.state, good.state) == ('failed', FINISHED)
    assert 'the worker ended' in bad.error
    assert rows_of(tmp_path)['bad']['state'] == 'failed'


@pytest.mark.parametrize('words, network, paths', [
    (['in', 'out'], None, ['in', 'out']), (['--network', 'in', 'out'], '', ['in', 'out']),
    (['in', '--network', 'out'], '', ['in', 'out']),
    (['in', 'out', '--network'], '', ['in', 'out']),
    (['in', '--network', 'fastdepth', 'out'], 'fastdepth', ['in', 'out']),
    (['--network', 'a/b.onnx', 'in'], 'a/b.onnx', ['in'])])
def test_network_takes_the_name_of_one_only(words, network, paths):
    arguments = parse(words)
    assert (arguments.network, arguments.paths) == (network, paths)


@pytest.mark.parametrize('backend, module', [('dask', 'dask'), ('ray', 'ray')])
def test_a_missing_backend_is_reported(bag, tmp_path, capsys, monkeypatch, backend,
                                                 module):
    monkeypatch.setitem(sys.modules, module, None)
    code = main(['--backend', backend, '--scheduler', 'tcp://127.0.0.1:1', '--depth', DEPTH,
                 '--output-folder', str(tmp_path / 'out'), str(bag)])
    assert code == 1
    assert 'needs pip install' in capsys.readouterr().err


def test_dask_needs_a_scheduler(bag, tmp_path, capsys):
    assert main(['--backend', 'dask', '--output-folder', str(tmp_path / 'out'), str(bag)]) == 1
    assert '--scheduler tcp://HOST:8786' in capsys.readouterr().err
