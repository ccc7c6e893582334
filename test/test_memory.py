# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Freed arrays are not returned to the kernel and fetched again."""

import platform
import resource

import numpy as np
import pytest

from plane_detector.memory import retain_freed_memory


@pytest.mark.skipif(platform.libc_ver()[0] != 'glibc', reason='mallopt belongs to glibc')
def test_arrays_of_the_size_of_images_cause_no_page_faults_twice():
    assert retain_freed_memory()
    pages = 8 * 2**20 // resource.getpagesize()
    for _ in range(2):
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        for _ in range(20):
            first, second = np.ones(2**20, np.float32), np.ones(2**20, np.float32)
            del first, second
        faults = resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
    assert faults < 2 * pages  # else 20 times as many


def test_settings_of_the_user_are_kept(monkeypatch):
    monkeypatch.setenv('MALLOC_TRIM_THRESHOLD_', '131072')
    assert not retain_freed_memory.__wrapped__()
