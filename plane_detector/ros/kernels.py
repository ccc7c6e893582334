# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Compile the loops of the stages: of those configured before the first frame, of others later.

Machine code is loaded from the user's cache if possible. Compiling takes some ten seconds or more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from plane_detector.compilation import are_ready, compile_kernels
from plane_detector.config import Config
from plane_detector.stopping import Background


def load_kernels(config: Config, log: Callable[[str], None]) -> None:
    """Load the machine code from the user's cache, or compile it and report that to ``log``."""
    subjects = ['ros', 'drawing', 'geometry', 'segmentation', 'directions', 'planes', 'ground']
    if config.shapes.wanted:
        subjects.append('shapes')
    compile_kernels(subjects, log)


class LateKernels:
    """
    Loads the loops of shapes requested while the node runs; until then, planes only are searched.

    Parameters
    ----------
    log : callable
        Called with a message if the loops must be compiled.

    """

    def __init__(self, log: Callable[[str], None]) -> None:
        self._log = log
        self._call: Background[None] | None = None

    @property
    def is_loading(self) -> bool:
        """Whether shapes are held back now."""
        return self._call is not None and not self._call.wait(0.0)

    def usable(self, config: Config) -> Config:
        """Return the settings for the next frame; begin to load what they lack, in a thread."""
        if not config.shapes.wanted or are_ready('shapes'):
            return config
        if self._call is None:
            self._call = Background(self._load, 'load_kernels')
        if self.is_loading:
            return replace(config, shapes=replace(config.shapes, types='none'))
        return config  # if they could not be compiled, the frame will say why

    def _load(self) -> None:
        compile_kernels(['shapes'], self._log, 'the loops of shapes.types (planes are found '
                        'meanwhile)')
