# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
import os
import socket
import subprocess
import sys

import pytest
from zoo_helpers import CONTENT, SHA256, files_in, put, serving

from plane_detector.depth import download, model_zoo
from plane_detector.depth.model_zoo import (
    AUTO_ORDER,
    NETWORKS,
    NetworkUnavailableError,
    choose,
    default_cache_dir,
    fetch,
)
from plane_detector.depth.sources import UrlSource


@pytest.fixture(name='server')
def fixture_server(monkeypatch):
    monkeypatch.setenv('no_proxy', '*')
    with serving() as server:
        yield server


@pytest.fixture(name='silent_url')
def fixture_silent_url(monkeypatch):
    """A host that accepts the connection and never answers."""
    monkeypatch.setenv('no_proxy', '*')
    monkeypatch.setattr(download, 'ANSWER_TIMEOUT_S', 0.2)
    with socket.create_server(('127.0.0.1', 0)) as listener:
        yield f'http://127.0.0.1:{listener.getsockname()[1]}'


def test_a_fetched_file_is_whole_verified_and_then_cached(server, tmp_path, monkeypatch):
    network = put(monkeypatch, 'fastdepth', UrlSource(server.url + '/good.onnx'))
    path = fetch('fastdepth', tmp_path / 'new' / 'cache')
    assert path == tmp_path / 'new' / 'cache' / network.file_name
    assert path.read_bytes() == CONTENT
    assert fetch('fastdepth', tmp_path / 'new' / 'cache') == path
    assert server.asked == ['/good.onnx']
    assert files_in(path.parent) == [network.file_name]


@pytest.mark.parametrize(('file', 'said'), [
    ('/other.onnx', f'has SHA-256 [0-9a-f]{{64}} .1280000 bytes., not {SHA256}'),
    ('/broken.onnx', r'\(1000 bytes\).*incomplete|is unreachable'),
    ('/longer.onnx', r'sends more than the \d+ bytes that the file has'),
    ('/stalled.onnx', 'is unreachable .*timed out'),
    ('/missing.onnx', '404')])
def test_a_wrong_download_leaves_no_file(
        server, tmp_path, monkeypatch, file, said):
    monkeypatch.setattr(download, 'ANSWER_TIMEOUT_S', 0.5)
    put(monkeypatch, 'fastdepth', UrlSource(server.url + file))
    with pytest.raises(NetworkUnavailableError, match=said):
        fetch('fastdepth', tmp_path)
    assert files_in(tmp_path) == []


def test_a_file_half_written_by_a_killed_process_is_not_used(tmp_path, monkeypatch, server):
    network = put(monkeypatch, 'fastdepth', UrlSource(server.url + '/good.onnx'))
    program = ('import os, sys; from pathlib import Path; '
               'from plane_detector.depth import download\n'
               'def chunks():\n    yield b"abc"\n    os._exit(9)\n'
               'download.write_verified(Path(sys.argv[1]), chunks(), "0" * 64)')
    subprocess.run([sys.executable, '-c', program, str(tmp_path / network.file_name)],
                   check=False, env={**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)})
    assert not (tmp_path / network.file_name).exists()
    assert fetch('fastdepth', tmp_path).read_bytes() == CONTENT


def test_a_damaged_file_in_the_cache_is_downloaded_again(server, tmp_path, monkeypatch):
    network = put(monkeypatch, 'fastdepth', UrlSource(server.url + '/good.onnx'))
    (tmp_path / network.file_name).write_bytes(CONTENT[:-1])
    assert fetch('fastdepth', tmp_path).read_bytes() == CONTENT
    put(monkeypatch, 'fastdepth', UrlSource(server.url + '/missing.onnx'))
    (tmp_path / network.file_name).write_bytes(CONTENT[:-1])
    with pytest.raises(NetworkUnavailableError, match='the cached file is damaged, .*404'):
        fetch('fastdepth', tmp_path)


def test_a_slow_server_is_abandoned(server, tmp_path, monkeypatch):
    monkeypatch.setattr(download, 'GRACE_S', 0.5)
    put(monkeypatch, 'fastdepth', UrlSource(server.url + '/dripping.onnx'))
    # 1280000 bytes at 50 a second would take seven hours.
    with pytest.raises(NetworkUnavailableError, match=r'sent \d+ bytes in \d+ s, too slow'):
        fetch('fastdepth', tmp_path)
    assert files_in(tmp_path) == []


def test_offline_errors_explain_the_download_by_hand(tmp_path, monkeypatch, silent_url):
    network = put(monkeypatch, 'fastdepth', UrlSource(silent_url + '/n.onnx'))
    with pytest.raises(FileNotFoundError) as caught:
        fetch('fastdepth', tmp_path)
    for said in (str(tmp_path / network.file_name), silent_url + '/n.onnx', SHA256,
                 f'{len(CONTENT)} bytes', 'is unreachable (no answer within 0.2 s)'):
        assert said in str(caught.value)


def test_the_next_source_is_tried_if_one_lacks_the_file(server, tmp_path, monkeypatch):
    sources = [UrlSource(f'{server.url}/{name}.onnx') for name in ('missing', 'other', 'good')]
    put(monkeypatch, 'fastdepth', *sources)
    assert fetch('fastdepth', tmp_path).read_bytes() == CONTENT
    assert server.asked == ['/missing.onnx', '/other.onnx', '/good.onnx']
    put(monkeypatch, 'fastdepth', *sources[:2])
    with pytest.raises(NetworkUnavailableError, match='404.*; the downloaded data has SHA-256'):
        fetch('fastdepth', tmp_path / 'elsewhere')


def test_a_read_only_folder_is_reported_once_with_the_parameter(tmp_path, monkeypatch,
                                                                         server):
    for name in AUTO_ORDER:
        put(monkeypatch, name, UrlSource(server.url + '/good.onnx'))
    (tmp_path / 'file').write_text('in the way')
    with pytest.raises(FileNotFoundError) as caught:
        choose(tmp_path / 'file' / 'cache')
    assert str(caught.value).count('cannot be written') == 1
    assert str(caught.value).endswith('name another folder by depth.cache_dir')
    assert len(str(caught.value)) < 300
    assert server.asked == []


def test_auto_uses_the_best_available_network_and_says_why(tmp_path, monkeypatch, server):
    first, second, third = AUTO_ORDER
    put(monkeypatch, first, UrlSource(server.url + '/missing.onnx'))
    put(monkeypatch, second, UrlSource(server.url + '/good.onnx'))
    put(monkeypatch, third, UrlSource(server.url + '/good.onnx'))
    network, path, reason = choose(tmp_path)
    assert network.name == second
    assert path.read_bytes() == CONTENT
    assert f'auto took {second} (fetched)' in reason
    assert first in reason
    assert '404' in reason
    assert choose(tmp_path)[2].startswith(f'auto took {second} (cached)')
    put(monkeypatch, first, UrlSource(server.url + '/good.onnx'))
    assert choose(tmp_path)[2] == f'auto took {first} (fetched)'


def test_auto_can_be_limited_to_one_kind_of_output(tmp_path, monkeypatch, server):
    for name in AUTO_ORDER:
        put(monkeypatch, name, UrlSource(server.url + '/good.onnx'))
    network, _, _ = choose(tmp_path, 'relative_disparity')
    assert network.output == 'relative_disparity'
    with pytest.raises(ValueError, match='no network of the zoo gives disparity'):
        choose(tmp_path, 'disparity')


def test_a_host_with_a_wrong_file_is_asked_for_the_next_network(tmp_path, monkeypatch, server):
    first, second = AUTO_ORDER[:2]
    put(monkeypatch, first, UrlSource(server.url + '/longer.onnx'))
    put(monkeypatch, second, UrlSource(server.url + '/good.onnx'))
    network, _, reason = choose(tmp_path)
    assert network.name == second
    assert 'unreachable' not in reason


def test_auto_contacts_a_silent_host_once_and_says_what_to_do(tmp_path, monkeypatch, silent_url):
    for name in AUTO_ORDER:
        put(monkeypatch, name, UrlSource(f'{silent_url}/{name}.onnx'))
    asked = []
    monkeypatch.setattr(download, '_answer', wrapped(download._answer, asked))
    with pytest.raises(FileNotFoundError) as caught:
        choose(tmp_path)
    assert asked == [f'{silent_url}/{AUTO_ORDER[0]}.onnx']
    assert all(NETWORKS[name].file_name in str(caught.value) for name in AUTO_ORDER)
    assert 'was unreachable a moment ago' in str(caught.value)


def wrapped(function, calls):
    def call(argument):
        calls.append(argument)
        return function(argument)
    return call


def test_the_cache_folder_follows_the_xdg_specification(monkeypatch, tmp_path):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    assert default_cache_dir() == tmp_path / 'plane_detector'
    for unset in ('', 'relative/path'):
        monkeypatch.setenv('XDG_CACHE_HOME', unset)
        monkeypatch.setenv('HOME', str(tmp_path))
        assert default_cache_dir() == tmp_path / '.cache' / 'plane_detector'


def test_the_zoo_is_consistent():
    assert set(AUTO_ORDER) <= set(NETWORKS)
    for name, network in NETWORKS.items():
        assert network.name == name
        assert len(bytes.fromhex(network.sha256)) == 32
        assert network.output in ('metric_depth', 'disparity', 'relative_disparity')
        assert network.short_side % network.side_multiple == 0
        # Only weights that anybody may use for anything, or those that are asked for by name.
        assert network.licence in ('Apache-2.0', 'MIT') or network.is_opt_in
    assert not any(NETWORKS[name].is_opt_in for name in AUTO_ORDER)
    assert len({network.file_name for network in NETWORKS.values()}) == len(NETWORKS)
    assert model_zoo.NETWORKS[AUTO_ORDER[0]].output == 'metric_depth'
