# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0

import pytest
from zoo_helpers import CONTENT, put

from plane_detector.depth.download import UrlSource
from plane_detector.depth.networks import AUTO_ORDER, NETWORKS
from plane_detector.tools.fetch import main


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
