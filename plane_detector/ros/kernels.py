# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Compile the loops of the configured stages before the first frame."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from plane_detector.compilation import compile_kernels
from plane_detector.config import Config


def load_kernels(config: Config, log: Callable[[str], None]) -> None:
    """Load the machine code from the user's cache, or compile it and report that to ``log``."""
    subjects = ['ros', 'drawing', 'geometry', 'segmentation', 'directions', 'planes']
    if config.shapes.wanted:
        subjects.append('shapes')
    compile_kernels(subjects, partial(log, 'compiling the loops for this machine, once'))
