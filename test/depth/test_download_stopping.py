# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A download can be stopped, whatever the server does, and leaves no files."""

import socket
import threading
import time

import pytest

from plane_detector.depth import download
from plane_detector.depth.download import url_chunks, write_verified
from plane_detector.stopping import Background, Stopped


@pytest.fixture
def server():
    """Yield the address of a server, and a function that sets what it sends before it waits."""
    listening, sent, ended = socket.create_server(('127.0.0.1', 0)), [], threading.Event()

    def serve():
        client, _ = listening.accept()
        with client:
            client.recv(1 << 16)
            for part in sent:
                client.sendall(part)
            while not ended.wait(0.05):
                if sent:
                    client.sendall(b'x')

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    yield f'http://127.0.0.1:{listening.getsockname()[1]}/network.onnx', sent
    ended.set()
    thread.join(5.0)
    listening.close()


@pytest.mark.parametrize('sent', [
    [], [b'HTTP/1.1 200 OK\r\nContent-Length: 1000000\r\n\r\nx']], ids=['silent', 'dripping'])
def test_a_download_can_be_stopped(server, sent, tmp_path, monkeypatch):
    monkeypatch.setenv('no_proxy', '*')
    monkeypatch.setattr(download, 'ANSWER_TIMEOUT_S', 60.0)
    address, to_send = server
    to_send += sent
    target = tmp_path / 'network.onnx'
    call = Background(lambda: write_verified(target, url_chunks(address, 10**6, set()), '0' * 64),
                      'download')
    end_s = time.monotonic() + 20
    while sent and not any(path.stat().st_size for path in tmp_path.iterdir()):
        assert time.monotonic() < end_s
        time.sleep(0.01)
    call.stop.set()
    with pytest.raises(Stopped):
        call.result()
    assert list(tmp_path.iterdir()) == []
