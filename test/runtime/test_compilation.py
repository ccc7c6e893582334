# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Kernels are compiled once, into a cache that what is compiled names and only its user writes."""

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from plane_detector import Config, PlaneDetector
from plane_detector._runtime import compilation
from plane_detector.config import DepthConfig

SAMPLE = """
from plane_detector._runtime.compilation import compile_kernels, kernel
from sample.stage.columns import COLUMN
from sample.stage.parts import part
@kernel('f8(f8[:])')
def selected(row):
    return part(row[COLUMN])
@kernel('f8(f8)', subject='later')
def halved(value):
    return value / 2
"""
PART = """
from plane_detector._runtime.compilation import kernel
@kernel('f8(f8)')
def part(value):
    return value {sign} 1
"""
RUN = """
import sys
from plane_detector._runtime import compilation
{before}
from plane_detector._runtime.compilation import compile_kernels
import numpy as np, sample.stage.loops
compile_kernels(['stage'], print)
print(sample.stage.loops.selected(np.array([10.0, 20.0])))
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return a new cache folder."""
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'cache'))
    compilation.cache_folder.cache_clear()
    yield tmp_path / 'cache' / 'plane_detector' / 'kernels'
    compilation.cache_folder.cache_clear()


@pytest.fixture
def sample(tmp_path, monkeypatch, folder):
    """Return a function: constant, sign -> what a program with kernels of two files prints."""
    stage = tmp_path / 'sample' / 'stage'
    stage.mkdir(parents=True)
    monkeypatch.setenv('PYTHONPATH', os.pathsep.join([str(tmp_path), *sys.path]))
    # Python itself would take its old bytecode for a file of the same size and time.
    monkeypatch.setenv('PYTHONDONTWRITEBYTECODE', '1')

    def run(column, sign, before=''):
        for name, text in (('columns', f'COLUMN = {column}'), ('loops', SAMPLE),
                           ('parts', PART.format(sign=sign))):
            file = stage / f'{name}.py'
            file.write_text(text, encoding='utf-8')
            os.utime(file, (1, 1))
        return subprocess.run(
            [sys.executable, '-c', RUN.format(before=before)], text=True, check=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT).stdout.splitlines()
    return run


def test_changes_in_other_files_are_compiled_and_code_not_used_for_a_month_is_removed(
        sample, folder):
    """Of files with the same size and time, which numba does not read for this kernel."""
    printed = sample(0, '+')
    assert printed[0].startswith('compiling the kernels for this machine')
    assert printed[-1] == '11.0'
    assert list(folder.glob('*/*/*selected*.nbc')) and not list(folder.glob('*/*/*halved*'))
    assert sample(1, '+')[-1] == '21.0'
    assert sample(1, '-')[-1] == '19.0'
    for name in ('old', 'recent'):
        (folder / name).mkdir()
    for path in folder.iterdir():
        days = 29 if path.name == 'recent' else 31
        os.utime(path, (time.time() - 86400 * days,) * 2)
    for _ in range(2):
        assert sample(1, '-') == ['19.0']  # loaded and kept, which takes no time to tell of
    assert not (folder / 'old').exists()
    assert (folder / 'recent').exists()


def test_a_helper_runs_nothing_out_of_the_working_directory(sample, tmp_path):
    """Neither as this package nor as one of Python."""
    planted = tmp_path / 'planted'
    planted.mkdir()
    for name in ('plane_detector', 'numba', 'hashlib', 'sitecustomize'):
        (planted / f'{name}.py').write_text(f'open({str(tmp_path / "ran")!r}, "w")')
    # An empty entry, which setup files leave behind, is the working directory.
    before = (f'import os; os.chdir({str(planted)!r}); os.environ["PYTHONPATH"] += os.pathsep; '
              'sys.path = [p for p in sys.path if p]')
    assert sample(0, '+', before=before)[-1] == '11.0'
    assert not (tmp_path / 'ran').exists()


def test_a_helper_that_fails_is_reported(sample):
    """And the loops are compiled all the same."""
    printed = sample(0, '+', before='compilation._HELPER = "raise SystemError(1234)"')
    assert ('a helper process has failed, so compiling takes longer: SystemError: 1234'
            in printed)
    assert printed[-1] == '11.0'


@pytest.mark.parametrize('name', ['blender', 'uwsgi', 'python_host', ''])
def test_a_program_that_embeds_python_is_not_started_as_a_helper(name, sample, tmp_path,
                                                                 monkeypatch):
    mark, program = tmp_path / 'was started', tmp_path / (name or 'none')
    program.write_text(f'#!/bin/sh\ntouch "{mark}"\n')
    program.chmod(0o755)
    embedded = f"sys.executable = {str(program) if name else ''!r}"
    printed = sample(0, '+', before=embedded)
    assert printed[-1] == '11.0' and 'takes longer' not in ''.join(printed)
    without = embedded + "; sys.prefix = sys.base_prefix = '/nowhere'"
    printed = sample(1, '-', before=without)
    assert printed[-1] == '19.0' and 'is not Python and none is in /nowhere' in ''.join(printed)
    assert not mark.exists()


@pytest.mark.parametrize('fault', [
    'resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))',
    "os.environ['XDG_CACHE_HOME'] = '/proc/none'; tempfile.tempdir = '/proc/none'"])
def test_without_room_on_the_disk_the_loops_stay_in_memory_and_the_folder_is_named(
        sample, folder, fault):
    printed = sample(0, '+', before=f'import os, resource, tempfile; {fault}')
    assert printed[-1] == '11.0'
    warning, = (line for line in printed if 'stay in memory' in line)
    assert str(folder) in warning or '/proc/none' in warning


def test_measured_depth_needs_only_kernels_compiled_at_the_start(room, monkeypatch):
    """None that only a network needs, and none that has become part of its only caller."""
    called, call = set(), compilation.Kernel.__call__

    def record(self, *arguments):
        called.add(self)
        return call(self, *arguments)
    monkeypatch.setattr(compilation.Kernel, '__call__', record)
    scene = room(0)
    rgb = np.zeros((*scene.depth_m.shape, 3), np.uint8)
    detector = PlaneDetector(Config(depth=DepthConfig(source='topic')))
    assert detector.detect(rgb, scene.intrinsics, scene.depth_m, np.array([0.0, 1.0, 0.0])).planes
    assert len(called) > 30
    assert not [one.__name__ for one in called if one.subject == 'network' or one._is_called_once]


def test_machine_code_is_in_a_folder_that_only_its_user_writes(folder, tmp_path, monkeypatch):
    assert compilation.cache_folder() == folder
    assert folder.stat().st_mode & 0o777 == 0o700
    monkeypatch.setenv('XDG_CACHE_HOME', '/proc/none')
    monkeypatch.setattr(compilation.tempfile, 'tempdir', str(tmp_path))
    compilation.cache_folder.cache_clear()
    temporary = compilation.cache_folder()
    assert temporary.parent == tmp_path
    assert temporary.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize('kind', ['of another user', 'writable', 'link'])
def test_a_planted_folder_is_not_used(kind, folder, tmp_path, monkeypatch, caplog):
    """Numba unpickles what it finds in its cache."""
    monkeypatch.setenv('XDG_CACHE_HOME', '/proc/none')
    monkeypatch.setattr(compilation.tempfile, 'tempdir', str(tmp_path))
    planted = tmp_path / f'plane_detector-{os.getuid()}'
    if kind == 'link':
        (tmp_path / 'elsewhere').mkdir(mode=0o700)
        planted.symlink_to(tmp_path / 'elsewhere')
    else:
        planted.mkdir(mode=0o700)
    if kind == 'writable':
        planted.chmod(0o777)
    if kind == 'of another user':
        user = os.getuid()
        planted.rename(tmp_path / f'plane_detector-{user + 1}')
        monkeypatch.setattr(os, 'getuid', lambda: user + 1)
    used = compilation.cache_folder()
    assert used.parent == tmp_path
    assert used.name.removeprefix('plane_detector-') not in (
        'elsewhere', str(os.getuid()))
    assert 'compiled again at each start' in caplog.text


@pytest.mark.parametrize(('mode', 'owner', 'is_used'), [
    (0o755, 0, True), (0o775, 0, True), (0o777, 0, False), (0o1777, 0, True), (0o755, 1, False)])
def test_a_folder_that_another_user_could_replace_is_not_used(
        folder, tmp_path, monkeypatch, mode, owner, is_used):
    """0o775 is what a user with a group of its own gives."""
    folder.parent.mkdir(parents=True)
    folder.parent.chmod(mode)
    monkeypatch.setattr(compilation.tempfile, 'tempdir', str(tmp_path))
    look = Path.stat
    if owner:
        monkeypatch.setattr(Path, 'stat', lambda path, **how: os.stat_result(
            value + (k == 4) * 12345 for k, value in enumerate(look(path, **how)[:10])))
    assert (compilation.cache_folder() == folder) == is_used


@pytest.mark.parametrize('is_short', [False, True])
def test_other_threads_run_beside_a_kernel_unless_it_is_short(is_short, folder, monkeypatch):
    monkeypatch.setattr(compilation, '_KERNELS', [])
    one = compilation.Kernel(last_of_sequence, 'i8(i8)', is_short)
    one(1)
    turns, ended = [], threading.Event()

    def take_turns():
        while not ended.wait(0.001):
            turns.append(1)
    thread = threading.Thread(target=take_turns)
    thread.start()
    during = []
    for _ in range(5):
        before = len(turns)
        one(30_000_000)
        during.append(len(turns) - before)
    ended.set()
    thread.join()
    # On a busy machine the thread may take turns before and after the kernel, or none at all.
    assert min(during) <= 1 if is_short else max(during) > 3, during


def last_of_sequence(steps):
    value = steps
    for _ in range(steps):  # no formula: a compiler cannot leave the loop out
        value = (value ^ (value >> 7)) * 6364136223846793005 + 1442695040888963407
    return value


def test_kernels_run_and_are_called_after_their_intermediate_code_is_freed(sample):
    after = """
import numba
import numpy as np
from plane_detector._runtime import compilation
from sample.stage.loops import halved, selected
from sample.stage.parts import part
compilation.compile_kernels(['stage', 'later'])
part.compiled()
compilation.free_intermediate_code()
for one in (selected, halved, part):
    (overload,) = one.compiled().overloads.values()
    print(one.__name__, overload.library._shared_module is None)
print(selected(np.array([10.0, 20.0])), halved(8.0))
called = part.compiled()
print(numba.njit('f8(f8)')(lambda value: called(value) + called(value))(4.0))
"""
    run = 'import sample.stage.loops\n' + after
    first = sample(1, '+', before=run)
    loaded = sample(1, '+', before=run)
    # What is compiled, and what is loaded from the cache.
    for lines in (first, loaded):
        lines = [line for line in lines if 'kernels' not in line]
        assert lines == ['selected True', 'halved True', 'part False', '21.0 4.0', '10.0', '21.0']
