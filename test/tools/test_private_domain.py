# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Domains of DDS that no two processes share."""

import subprocess
import sys

import pytest

from plane_detector.tools import private_domain as module
from plane_detector.tools.private_domain import private_domain

HOLDS = ('from plane_detector.tools.private_domain import private_domain\n'
         'print(private_domain(), flush=True)\ninput()')


@pytest.fixture
def other():
    """Return a process that holds a domain, and this domain."""
    process = subprocess.Popen([sys.executable, '-c', HOLDS], stdin=subprocess.PIPE,
                               stdout=subprocess.PIPE, text=True)
    yield process, int(process.stdout.readline())
    process.kill()
    process.communicate()


def test_a_domain_is_held_until_the_process_is_killed(other, monkeypatch):
    process, domain = other
    monkeypatch.setattr(module.random, 'shuffle', lambda domains: domains.sort(
        key=lambda one: one != domain))  # the other's first
    assert private_domain() != domain
    process.kill()
    process.wait()
    assert private_domain() == domain


def test_none_left_is_said(monkeypatch):
    monkeypatch.setattr(module, '_LARGEST_DOMAIN', 0)
    with pytest.raises(RuntimeError, match='all taken'):
        private_domain()
