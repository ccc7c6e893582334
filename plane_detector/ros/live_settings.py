# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Settings of a running node: declared as parameters, checked, and changed between frames.

The kernels that they need are loaded from the user's cache if possible: before the first frame for
the stages configured then, later for others. Compiling takes some ten seconds or more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from plane_detector._runtime.compilation import are_ready, compile_kernels
from plane_detector._runtime.stopping import Background
from plane_detector.config import Config, NodeConfig
from plane_detector.ros import parameters


def load_kernels(config: Config, log: Callable[[str], None]) -> None:
    """Load the machine code from the user's cache, or compile it and report that to ``log``."""
    subjects = ['ros', 'drawing', 'geometry', 'segmentation', 'directions', 'planes', 'ground',
                'tracking']
    if not config.depth.is_measured:
        subjects.append('network')
    if config.depth.transport == 'compressedDepth':
        subjects.append('rvl')
    if config.shapes.wanted:
        subjects.append('shapes')
    if config.map.enabled:
        subjects.append('mapping')
    compile_kernels(subjects, log)


class LateKernels:
    """Loads kernels of shapes requested while the node runs; meanwhile it finds only planes."""

    def __init__(self, log: Callable[[str], None]) -> None:
        self._log = log
        self._call: Background[None] | None = None

    @property
    def is_loading(self) -> bool:
        """Whether shapes are held back now."""
        return self._call is not None and not self._call.wait(0.0)

    def without_unready_shapes(self, config: Config) -> Config:
        """Return the settings for the next frame; start to load missing kernels in a thread."""
        if not config.shapes.wanted or are_ready('shapes'):
            return config
        if self._call is None:
            self._call = Background(self._load, 'load_kernels')
        if self.is_loading:
            return replace(config, shapes=replace(config.shapes, types='none'))
        return config  # if they could not be compiled, the frame reports why

    def _load(self) -> None:
        compile_kernels(['shapes'], self._log, 'the kernels of shapes.types (planes are found '
                        'meanwhile)')


class LiveSettings:
    """
    Current settings, from the parameters that it declares on a node.

    ``is_configured`` returns whether the settings that are fixed while configured may not change
    now; ``on_change`` is called after each change, in the thread of the executor. Raises
    ValueError if a parameter has an invalid value.
    """

    def __init__(self, node: Node, is_configured: Callable[[], bool],
                 on_change: Callable[[], None]):
        self._is_configured, self._on_change = is_configured, on_change
        self.config = parameters.declare(node, Config())
        self.settings = parameters.declare(node, NodeConfig())
        self.late_kernels = LateKernels(node.get_logger().info)
        parameters.warn_of_unknown(node)
        node.add_pre_set_parameters_callback(self._with_floats)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._take)

    def _with_floats(self, changed: list[Parameter]) -> list[Parameter]:
        return parameters.with_floats(self.settings,
                                      parameters.with_floats(self.config, changed))

    def _check(self, changed: list[Parameter]) -> SetParametersResult:
        try:
            fixed = [name for old in (self.config, self.settings)
                     for name in parameters.fixed_changes(old, parameters.updated(old, changed))]
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        if fixed and self._is_configured():
            return SetParametersResult(successful=False, reason=(
                f'{", ".join(fixed)}: read when the node is configured; deactivate it, clean up, '
                'set this, then configure and activate'))
        return SetParametersResult(successful=True)

    def _take(self, changed: list[Parameter]) -> None:
        before = self.config, self.settings
        self.config = parameters.updated(self.config, changed)
        self.settings = parameters.updated(self.settings, changed)
        # A new subscription declares its qos_overrides, for which rclpy calls this again.
        if (self.config, self.settings) != before:
            self._on_change()
