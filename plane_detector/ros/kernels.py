# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The loops of the segmentation are compiled before the first frame, not with it."""

from __future__ import annotations

from collections.abc import Callable

from plane_detector.segmentation.compilation import are_compiled, compile_kernels


def load_kernels(log: Callable[[str], None]) -> None:
    """Load the machine code from the user's cache, or compile it and say so to ``log``."""
    if not are_compiled():
        log('compiling the loops of the segmentation for this machine, once')
    compile_kernels()
