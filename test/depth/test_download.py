# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Downloads are limited, and safe in parallel."""

import os
import subprocess
import sys
import time

import pytest
from zoo_helpers import CONTENT, SHA256, files_in, put, serving

from plane_detector.depth import download
from plane_detector.depth.model_zoo import NetworkUnavailableError, fetch
from plane_detector.depth.sources import UrlSource


@pytest.fixture(name='server')
def fixture_server(monkeypatch):
    monkeypatch.setenv('no_proxy', '*')
    with serving() as server:
        yield server


def test_two_writers_of_the_same_process_id_do_not_meet(tmp_path, monkeypatch):
    # As two containers do that share a volume: the second starts while the first is writing.
    monkeypatch.setattr(os, 'getpid', lambda: 1)
    path = tmp_path / 'n.onnx'

    def interrupted():
        yield CONTENT[:1000]
        download.write_verified(path, [CONTENT], SHA256)
        assert path.read_bytes() == CONTENT
        yield CONTENT[1000:]

    download.write_verified(path, interrupted(), SHA256)
    assert path.read_bytes() == CONTENT
    assert files_in(tmp_path) == ['n.onnx']


def test_the_written_file_is_verified(tmp_path):
    path = tmp_path / 'n.onnx'

    def chunks():
        yield CONTENT[:1000]
        (temporary,) = tmp_path.iterdir()
        with open(temporary, 'r+b') as file:
            file.write(b'somebody else')
        yield CONTENT[1000:]

    with pytest.raises(OSError, match='has SHA-256'):
        download.write_verified(path, chunks(), SHA256)
    assert files_in(tmp_path) == []


def test_files_of_killed_downloads_are_removed_and_active_ones_kept(tmp_path):
    now_s = time.time()
    for name, age_s in (('.n.onnx.7.part', 2 * download.STALE_AFTER_S), ('.n.onnx.abc.part', 5),
                        ('.other.onnx.7.part', 2 * download.STALE_AFTER_S)):
        (tmp_path / name).write_bytes(b'half')
        os.utime(tmp_path / name, (now_s - age_s, now_s - age_s))
    download.write_verified(tmp_path / 'n.onnx', [CONTENT], SHA256)
    assert files_in(tmp_path) == ['.n.onnx.abc.part', '.other.onnx.7.part', 'n.onnx']


def test_a_slow_server_is_abandoned(server, tmp_path, monkeypatch):
    monkeypatch.setattr(download, 'GRACE_S', 0.5)
    put(monkeypatch, 'fastdepth', UrlSource(server.url + '/dripping.onnx'))
    # 1280000 bytes at 50 a second would take seven hours.
    with pytest.raises(NetworkUnavailableError, match=r'sent \d+ bytes in \d+ s, too slow'):
        fetch('fastdepth', tmp_path)
    assert files_in(tmp_path) == []


def test_the_size_is_bounded_without_a_progress_bar_too(server, tmp_path):
    program = ('import sys; from plane_detector.depth import download\n'
               f'for chunk in download.url_chunks(sys.argv[1], {len(CONTENT)}, set()): pass')
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path), 'no_proxy': '*',
                   'TQDM_DISABLE': '1'}
    done = subprocess.run([sys.executable, '-c', program, server.url + '/longer.onnx'],
                          check=False, capture_output=True, text=True, env=environment)
    assert f'sends more than the {len(CONTENT)} bytes that the file has' in done.stderr
    assert done.returncode != 0
