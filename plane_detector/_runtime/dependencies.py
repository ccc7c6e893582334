# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Messages of a program if a package that it needs is missing or broken.

Imports nothing but the standard library.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module

# By import name; the versions are those of setup.py. Ubuntu has no package for the last two.
REMEDIES = {
    'cv2': "apt install python3-opencv, or pip install 'opencv-python-headless>=4.8.1.78'",
    'joblib': "apt install python3-joblib, or pip install 'joblib>=1.3'",
    'numba': "apt install python3-numba, or pip install 'numba>=0.58'",
    'numpy': "apt install python3-numpy, or pip install 'numpy>=1.26'",
    'scipy': 'apt install python3-scipy, or pip install scipy',
    'skimage': 'apt install python3-skimage, or pip install scikit-image',
    'sklearn': 'apt install python3-sklearn, or pip install scikit-learn',
    'threadpoolctl': "apt install python3-threadpoolctl, or pip install 'threadpoolctl>=3.0'",
    'tqdm': 'apt install python3-tqdm, or pip install tqdm',
    'yaml': 'apt install python3-yaml, or pip install pyyaml',
    'onnxruntime': "PIP_BREAK_SYSTEM_PACKAGES=1 pip install 'onnxruntime>=1.22'",
    'rosbags': 'PIP_BREAK_SYSTEM_PACKAGES=1 pip install rosbags',
}


@contextmanager
def explained_imports(*needed: str) -> Iterator[None]:
    """
    End the process with exit code 1 and one line if an import of this block fails.

    ``needed`` are packages that the program imports only later, while it runs.
    """
    try:
        yield
        for name in needed:
            import_module(name)
    except ImportError as error:
        sys.exit(explanation(error))


def explanation(error: ImportError) -> str:
    """Return in one line why a package cannot be imported, and the remedy."""
    name, reason = (error.name or '').partition('.')[0], ' '.join(str(error).split())
    if name == 'plane_detector':
        raise error
    if name in REMEDIES:
        return f'{reason}: {REMEDIES[name]}'
    return f'{reason}: source /opt/ros/jazzy/setup.bash' if name else reason
