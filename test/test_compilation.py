# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Kernels are compiled when they are needed, into a cache that their sources name."""

import fcntl
import os
import subprocess
import sys
import threading
import time

import numba
import pytest

from plane_detector import compilation


def test_importing_the_package_does_not_import_numba():
    code = ('import sys, plane_detector; plane_detector.segment_planes; '
            'sys.exit("numba" in sys.modules)')
    assert subprocess.run([sys.executable, '-c', code], check=False).returncode == 0


def test_machine_code_is_in_a_folder_of_the_user(tmp_path, monkeypatch):
    compilation.cache_folder.cache_clear()
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    try:
        assert compilation.cache_folder().is_relative_to(tmp_path / 'plane_detector')
        monkeypatch.setenv('XDG_CACHE_HOME', '/proc/none')
        compilation.cache_folder.cache_clear()
        assert compilation.cache_folder().is_dir()
    finally:
        compilation.cache_folder.cache_clear()


def test_compiling_is_told_when_code_is_missing_not_when_it_is_loaded(tmp_path, monkeypatch):
    """Code of the same sources at another place, or of some kernels only, is not that code."""
    monkeypatch.setattr(compilation, 'cache_folder', lambda: tmp_path)
    told = []
    for expected in (['compiling'], ['compiling']):
        monkeypatch.setattr(compilation, '_KERNELS', [])
        kernels = [compilation.Kernel(function, 'i8(i8)') for function in (abs_of, double_of)]
        for one in kernels:
            one.subject = 'segmentation'
        for _ in range(2):  # what this process compiled a moment ago is ready the second time
            compilation.compile_kernels(['segmentation'], lambda: told.append('compiling'))
        assert told == expected
    assert kernels[1](3) == 6


def test_threads_that_compile_at_once_share_the_folder_of_the_user(monkeypatch):
    """Else machine code is written into the working directory."""
    before, seen = numba.config.CACHE_DIR, []

    def slow_njit(*_, **__):
        time.sleep(0.1 * (len(seen) + 1))  # the second would still compile when the first ends
        seen.append(numba.config.CACHE_DIR)
        return lambda function: function

    monkeypatch.setattr(numba, 'njit', slow_njit)
    monkeypatch.setattr(compilation, '_KERNELS', [])
    kernels = [compilation.Kernel(function, 'i8(i8)') for function in (abs_of, double_of)]
    threads = [threading.Thread(target=one.compiled) for one in kernels]
    for thread in threads:
        thread.start()
        time.sleep(0.05)
    for thread in threads:
        thread.join()
    assert seen == [str(compilation.cache_folder())] * 2
    assert before == numba.config.CACHE_DIR


def test_another_process_that_compiles_is_waited_for(tmp_path, monkeypatch):
    """Else every worker of many bags compiles all kernels, at the same time."""
    compiled = []
    monkeypatch.setattr(numba, 'njit', lambda *_, **__: lambda f: compiled.append(f) or f)
    monkeypatch.setattr(compilation, '_KERNELS', [])
    monkeypatch.setattr(compilation, 'cache_folder', lambda: tmp_path)
    kernel = compilation.Kernel(abs_of, 'i8(i8)')
    with open(tmp_path / 'lock', 'w', encoding='ascii') as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        thread = threading.Thread(target=kernel.compiled)
        thread.start()
        thread.join(0.2)
        assert not compiled
    thread.join()
    assert compiled == [abs_of]


def test_the_second_process_fills_the_cache_and_ends_with_its_parent(tmp_path):
    module = 'plane_detector.geometry.disparity'
    script = 'from plane_detector import compilation; compilation.compile_backwards()'
    for parent, written in (('1', []), (str(os.getpid()), ['_inverse'])):
        subprocess.run([sys.executable, '-c', script, parent, f'{module}:_inverse'], check=True,
                       env={**os.environ, 'XDG_CACHE_HOME': str(tmp_path)})
        assert [path.name.split('.')[1].split('-')[0]
                for path in tmp_path.rglob('*.nbi')] == written


@pytest.mark.parametrize('body', ['exit 1', 'exec sleep 60'], ids=['fails', 'hangs'])
def test_a_second_process_that_fails_or_hangs_holds_nobody_up(body, tmp_path, monkeypatch):
    program = tmp_path / 'python'
    program.write_text(f'#!/bin/sh\n{body}\n', encoding='utf-8')
    program.chmod(0o700)
    started, popen = [], subprocess.Popen
    monkeypatch.setattr(sys, 'executable', str(program))
    monkeypatch.setattr(os, 'sched_getaffinity', lambda _: {0, 1})
    monkeypatch.setattr(subprocess, 'Popen',
                        lambda *a, **k: started.append(popen(*a, **k)) or started[0])
    monkeypatch.setattr(compilation, 'cache_folder', lambda: tmp_path)
    monkeypatch.setattr(compilation, '_KERNELS', [])
    one = compilation.Kernel(double_of, 'i8(i8)')
    one.subject = 'segmentation'
    compilation.compile_kernels(['segmentation'])
    assert one(3) == 6
    assert [process.returncode is not None for process in started] == [True]


@pytest.mark.parametrize('is_short', [False, True])
def test_other_threads_run_beside_a_kernel_unless_it_is_short(is_short, tmp_path, monkeypatch):
    monkeypatch.setattr(compilation, 'cache_folder', lambda: tmp_path)
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
    # On a busy machine the thread may also take turns before and after the kernel.
    assert (min(during) <= 1) == is_short, during


def last_of_sequence(steps):
    value = steps
    for _ in range(steps):  # no formula: a compiler cannot leave the loop out
        value = (value ^ (value >> 7)) * 6364136223846793005 + 1442695040888963407
    return value


def abs_of(number):
    return abs(number)


def double_of(number):
    return 2 * number
