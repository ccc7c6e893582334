# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A network with known content in the zoo and a server with its file, for download tests."""

import contextlib
import dataclasses
import hashlib
import http.server
import threading

from plane_detector.depth.networks import NETWORKS

CONTENT = bytes(range(256)) * 5000
SHA256 = hashlib.sha256(CONTENT).hexdigest()


def put(monkeypatch, name, *sources, sha256=SHA256):
    network = dataclasses.replace(NETWORKS[name], sources=sources, sha256=sha256,
                                  size_bytes=len(CONTENT))
    monkeypatch.setitem(NETWORKS, name, network)
    return network


def files_in(folder):
    return sorted(path.name for path in folder.iterdir())


ESCAPE = b'\x1b[2J'
# Answers that are malformed, or never end: what is sent first, and what is sent from then on.
RAW = {'/length.onnx': (b'HTTP/1.1 200 OK\r\nContent-Length: abc\r\n\r\n12', b''),
       '/negative.onnx': (b'HTTP/1.1 200 OK\r\nContent-Length: -5\r\n\r\n12', b''),
       '/chunks.onnx': (b'HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n', b''),
       '/nowhere.onnx': (b'HTTP/1.1 302 Found\r\nLocation: http://[::1/n.onnx\r\n\r\n', b''),
       '/port.onnx': (b'HTTP/1.1 302 Found\r\nLocation: http://127.0.0.1:port/n\r\n\r\n', b''),
       '/name.onnx': (b'HTTP/1.1 302 Found\r\nLocation: http://' + 70 * b'a' + b'/n\r\n\r\n', b''),
       '/noise.onnx': (b'\0\xff\r\n\r\n', b''),
       '/escape.onnx': (b'HTTP/1.1 404 ' + ESCAPE + 50_000 * b'no ' + b'\r\n\r\n', b''),
       '/headers.onnx': (b'HTTP/1.1 200 OK\r\nX', b'x'),
       '/continue.onnx': (b'', b'HTTP/1.1 100 Continue\r\n\r\n')}


class Handler(http.server.BaseHTTPRequestHandler):
    """Serves CONTENT complete, damaged, truncated, stalled, too long, without end or slowly."""

    def do_GET(self):
        self.server.asked.append(self.path)
        if self.path in RAW:
            self.send_raw(*RAW[self.path])
            return
        if self.path == '/missing.onnx':
            self.send_error(404)
            return
        content = {'/other.onnx': CONTENT[:-1] + b'!', '/longer.onnx': CONTENT * 2}.get(
            self.path, CONTENT)
        self.send_response(200)
        if self.path == '/endless.onnx':
            content = CONTENT * 20
        else:
            self.send_header('Content-Length', str(len(content)))
        self.end_headers()
        if self.path == '/dripping.onnx':
            self.drip(content)
            return
        if self.path in ('/broken.onnx', '/stalled.onnx'):
            content = content[:1000]
        self.wfile.write(content)
        if self.path == '/stalled.onnx':
            self.server.ended.wait(60)

    def send_raw(self, begin, again):
        """Send bytes instead of an answer, then others again until the other side goes."""
        with contextlib.suppress(ConnectionError):
            self.wfile.write(begin)
            while again and not self.server.ended.wait(0.02):
                self.wfile.write(again)
        self.close_connection = True

    def drip(self, content):
        """Send a byte every 20 ms until the other side goes."""
        with contextlib.suppress(ConnectionError):
            for k in range(len(content)):
                self.wfile.write(content[k:k + 1])
                if self.server.ended.wait(0.02):
                    return

    def log_message(self, *_):
        pass


@contextlib.contextmanager
def serving():
    """Yield a server on this machine, with its ``url`` and what it was ``asked`` for."""
    server = http.server.ThreadingHTTPServer(('127.0.0.1', 0), Handler)
    server.asked = []
    server.ended = threading.Event()
    server.url = f'http://127.0.0.1:{server.server_port}'
    threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
    try:
        yield server
    finally:
        server.ended.set()
        server.shutdown()
        server.server_close()
