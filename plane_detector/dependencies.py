# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
What a program says if a package that it needs is missing, too old or broken.

Imports nothing but the standard library.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from typing import NamedTuple


class _Package(NamedTuple):
    distribution: str
    oldest: str  # as in setup.py; '0' if any will do
    of_ubuntu: str  # '' if Ubuntu has none


# By the name that is imported.
PACKAGES = {
    'numpy': _Package('numpy', '1.26', 'python3-numpy'),
    'numba': _Package('numba', '0.58', 'python3-numba'),
    'cv2': _Package('opencv-python-headless', '0', 'python3-opencv'),
    'scipy': _Package('scipy', '0', 'python3-scipy'),
    'sklearn': _Package('scikit-learn', '0', 'python3-sklearn'),
    'threadpoolctl': _Package('threadpoolctl', '3.0', 'python3-threadpoolctl'),
    'joblib': _Package('joblib', '1.3', 'python3-joblib'),
    'tqdm': _Package('tqdm', '0', 'python3-tqdm'),
    'yaml': _Package('pyyaml', '0', 'python3-yaml'),
    'onnxruntime': _Package('onnxruntime', '1.22', ''),
    'rosbags': _Package('rosbags', '0', ''),
    'skimage': _Package('scikit-image', '0', 'python3-skimage'),
}


@contextmanager
def explained_imports(*needed: str, installed: Sequence[str] = ()) -> Iterator[None]:
    """
    End the process with exit code 1 and one line if an import of this block fails.

    Parameters
    ----------
    *needed : str
        Packages that the program imports only later, when it works.
    installed : sequence of str
        Packages that some settings need and that are too large to import without them.

    """
    try:
        yield
        for name in needed:
            import_module(name)
    except ImportError as error:
        sys.exit(explanation(error))
    for name in installed:
        if find_spec(name) is None:
            sys.exit(_told(name, PACKAGES[name], ModuleNotFoundError(name=name)))
    for name, package in PACKAGES.items():
        module = sys.modules.get(name)
        found = getattr(module, '__version__', package.oldest)
        if _numbers(found) < _numbers(package.oldest):
            sys.exit(f'{name} {found} is too old, {package.oldest} is needed: '
                     f'{_remedy(package, is_installed=True)}')


def explanation(error: ImportError) -> str:
    """Return which package cannot be imported, the reason, what is installed, and the remedy."""
    for name, package in PACKAGES.items():
        try:
            import_module(name)
        except ImportError as reason:
            if reason.name == error.name and str(reason) == str(error):
                return _told(name, package, reason)
    if error.name is None:  # raised with its remedy
        return str(error)
    if error.name.startswith('plane_detector'):
        raise error
    return f'{error}: source the setup file of ROS, . /opt/ros/jazzy/setup.bash'


def _told(name: str, package: _Package, reason: ImportError) -> str:
    found = _version(package.distribution)
    if isinstance(reason, ModuleNotFoundError) and reason.name == name:
        return f'{name} is not installed: {_remedy(package, is_installed=False)}'
    beside = f', numpy {_version("numpy")}' if name != 'numpy' else ''
    return (f'{name} {found} cannot be imported ({" ".join(str(reason).split())}; Python '
            f'{sys.version.split()[0]}{beside}): {_remedy(package, is_installed=True)}')


def _remedy(package: _Package, is_installed: bool) -> str:
    """Return the command; pip replaces what Ubuntu's package cannot."""
    bound = '' if package.oldest == '0' else f'>={package.oldest}'
    wanted = f"install --upgrade '{package.distribution}{bound}'"
    if sys.prefix != sys.base_prefix:
        return f'{sys.executable} -m pip {wanted}'
    if package.of_ubuntu and not is_installed:
        return f'sudo apt install {package.of_ubuntu}'
    return f'PIP_BREAK_SYSTEM_PACKAGES=1 {sys.executable} -m pip {wanted}'


def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return 'of unknown version'


def _numbers(text: str) -> list[int]:
    return [int(number) for number in re.findall(r'\d+', text)[:3]]
