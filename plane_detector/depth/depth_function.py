# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Plain functions as depth models."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from plane_detector.types import CameraIntrinsics, Prediction


@dataclass(frozen=True)
class DepthFunction:
    """
    A function as a depth model.

    Attributes
    ----------
    function : callable
        Takes rgb (H, W, 3) uint8, returns depth or disparity (H, W) floating, NaN invalid.
    output : str
        Its output: ``metric_depth``, ``disparity`` or ``relative_disparity``.
    noise_share, focal_per_height
        As in :class:`~plane_detector.types.DepthModel`.
    blur_px : float
        Largest error of depth edges, in pixels.

    Examples
    --------
    >>> camera = CameraIntrinsics(3.0, 3.0, 1.0, 0.0, 3, 1)
    >>> wall = DepthFunction(lambda rgb: np.full(rgb.shape[:2], 2.0))
    >>> wall.predict(np.zeros((1, 3, 3), np.uint8), camera)
    Prediction(output='metric_depth', values=array([[2., 2., 2.]]), ...)

    """

    function: Callable[[np.ndarray], np.ndarray]
    output: str = 'metric_depth'
    noise_share: float = 0.0
    focal_per_height: float = 0.0
    blur_px: float = 0.0

    @property
    def facts(self) -> Mapping[str, str]:
        """Name of the function."""
        return {'depth_model': getattr(self.function, '__name__', type(self.function).__name__)}

    def edge_blur_px(self, width: int, height: int) -> float:
        """Return the largest error of depth edges."""
        return self.blur_px

    def fit_to_rate(self, rate_hz: float, other_s: float) -> None:
        """Do nothing: a function has only one speed."""

    def advise(self, share: float) -> str:
        """Return no advice."""
        return ''

    def predict(self, rgb: np.ndarray, intrinsics: CameraIntrinsics) -> Prediction:
        """Call the function; the intrinsics are not used."""
        return Prediction(self.output, self.function(rgb))


def wrapped(function: Callable[[np.ndarray], np.ndarray], output: str) -> DepthFunction:
    """
    Return a function wrapped as a depth model; output ``auto``: metres.

    Raises
    ------
    ValueError
        It has only some of the attributes of :class:`~plane_detector.types.DepthModel`.

    """
    wanted = ('output', 'noise_share', 'focal_per_height', 'facts', 'edge_blur_px', 'fit_to_rate',
              'advise', 'predict')
    there = [name for name in wanted if hasattr(function, name)]
    if there:
        raise ValueError(f'the depth model has {", ".join(there)}, but not '
                         f'{", ".join(name for name in wanted if name not in there)}: see '
                         'plane_detector.types.DepthModel, or wrap it in a DepthFunction')
    return DepthFunction(function, 'metric_depth' if output == 'auto' else output)
