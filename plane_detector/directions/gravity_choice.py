# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Choice of the direction of gravity: from a sensor, a parameter or the image."""

from __future__ import annotations

import numpy as np

from plane_detector.directions.vanishing import SceneDirections
from plane_detector.geometry.gravity import unit_direction
from plane_detector.types import COARSE_DEG, Gravity

# Largest likely error of gravity from lines, in standard deviations.
LIKELY_SIGMAS = 2.0


def choose_gravity(measured: np.ndarray | None, given: tuple[float, ...], tolerance_deg: float,
                   directions: SceneDirections | None, measured_by: str = 'measured') -> Gravity:
    """
    Return the first available of measured, given and image direction.

    Parameters
    ----------
    measured : (3,) floating, optional
        From an accelerometer or a calibrated mounting.
    given : (3,) float
        The parameter ``scale.gravity``; 0 0 0 means unknown.
    tolerance_deg : float
        Of both. A coarse direction is replaced by one of the image that agrees with it.
    directions : SceneDirections, optional
        Of the image, if they were estimated.
    measured_by : str
        Name of the source of the measured direction.

    """
    down = unit_direction(given if measured is None else measured)
    source = 'parameter' if measured is None else measured_by
    seen = None if directions is None else directions.gravity_camera
    if down is not None and (tolerance_deg <= COARSE_DEG or seen is None
                             or seen @ down < np.cos(np.radians(tolerance_deg))):
        return Gravity(down, tolerance_deg, source)
    if seen is None:
        return Gravity(None, tolerance_deg, 'none', directions.refusal if directions else '')
    sigma_deg = np.degrees(np.sqrt(np.trace(directions.covariance) / 2))
    return Gravity(seen, LIKELY_SIGMAS * float(sigma_deg), 'image',
                   probability=directions.probability)
