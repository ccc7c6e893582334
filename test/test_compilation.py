# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Kernels are compiled when they are needed, into a cache that their sources name."""

import subprocess
import sys

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
        assert not compilation.are_compiled('segmentation')
        monkeypatch.setenv('XDG_CACHE_HOME', '/proc/none')
        compilation.cache_folder.cache_clear()
        assert compilation.cache_folder().is_dir()
    finally:
        compilation.cache_folder.cache_clear()
