# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Which direction of gravity counts: a sensor's, the parameter's or that of the image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plane_detector.directions.vanishing import SceneDirections
from plane_detector.geometry.gravity import unit_direction

# Above this a given direction only tells the floor from the walls.
COARSE_DEG = 5.0
# Errors of gravity from lines, in standard deviations, that are still likely.
LIKELY_SIGMAS = 2.0


@dataclass(frozen=True)
class Gravity:
    """
    A direction of gravity and where it is from.

    Attributes
    ----------
    gravity_camera : (3,) float64 or None
        Unit direction in the optical frame; None where nothing tells it.
    tolerance_deg : float
        How far it may be off.
    source : str
        ``measured``, ``parameter``, ``image`` or ``none``.
    note : str
        Why the image does not tell it, where that was asked.

    """

    gravity_camera: np.ndarray | None
    tolerance_deg: float
    source: str
    note: str = ''

    @property
    def is_sure(self) -> bool:
        """Known, and well enough for angles."""
        return self.gravity_camera is not None and self.tolerance_deg <= COARSE_DEG


def choose_gravity(measured: np.ndarray | None, given: tuple[float, ...], tolerance_deg: float,
                   directions: SceneDirections | None) -> Gravity:
    """
    Take the first that is there: measured, given, of the image.

    Parameters
    ----------
    measured : (3,) floating, optional
        By an accelerometer or a calibrated mounting.
    given : (3,) float
        The parameter ``scale.gravity``; 0 0 0 is unknown.
    tolerance_deg : float
        Of both of them. A coarse direction gives way to one of the image that agrees with it.
    directions : SceneDirections, optional
        Of the image, where they were looked for.

    """
    down = unit_direction(given if measured is None else measured)
    source = 'parameter' if measured is None else 'measured'
    seen = None if directions is None else directions.gravity_camera
    if down is not None and (tolerance_deg <= COARSE_DEG or seen is None
                             or seen @ down < np.cos(np.radians(tolerance_deg))):
        return Gravity(down, tolerance_deg, source)
    if seen is None:
        return Gravity(None, tolerance_deg, 'none', directions.refusal if directions else '')
    sigma_deg = np.degrees(np.sqrt(np.trace(directions.covariance) / 2))
    return Gravity(seen, LIKELY_SIGMAS * float(sigma_deg), 'image')
