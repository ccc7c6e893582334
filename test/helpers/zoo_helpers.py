# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A network of known content in the zoo, for the tests of fetching it."""

import dataclasses
import hashlib

from plane_detector.depth.model_zoo import NETWORKS

CONTENT = bytes(range(256)) * 5000
SHA256 = hashlib.sha256(CONTENT).hexdigest()


def put(monkeypatch, name, source, sha256=SHA256):
    network = dataclasses.replace(NETWORKS[name], source=source, sha256=sha256,
                                  size_bytes=len(CONTENT))
    monkeypatch.setitem(NETWORKS, name, network)
    return network


def files_in(folder):
    return sorted(path.name for path in folder.iterdir())
