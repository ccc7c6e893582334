# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Direction of gravity in the optical frame, from settings or from an accelerometer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from plane_detector.geometry.rigid_transform import RigidTransform

_STANDARD_GRAVITY = 9.80665  # m/s^2
# A larger deviation from standard gravity means that the accelerometer is being moved.
_MAX_FORCE_ERROR_SHARE = 0.1
_SMOOTHING_S = 0.5


def unit_direction(direction: Sequence[float]) -> np.ndarray | None:
    """
    Return the direction (3,) with length 1; None for 0 0 0, which means unknown.

    Examples
    --------
    >>> unit_direction([0.0, 9.81, 0.0])
    array([0., 1., 0.])
    >>> unit_direction([0.0, 0.0, 0.0]) is None
    True

    """
    vector = np.asarray(direction, np.float64)
    length = np.linalg.norm(vector)
    return vector / length if length > 0 else None


def measured_direction(direction: Sequence[float]) -> np.ndarray:
    """
    Return a measured direction (3,) with length 1.

    Raises
    ------
    ValueError
        It is not 3 finite numbers, or all of them are 0.

    Examples
    --------
    >>> measured_direction([0, 9.81, 0])
    array([0., 1., 0.])
    >>> measured_direction([0.0, 0.0, 0.0, 1.0])
    Traceback (most recent call last):
    ValueError: gravity_camera must be 3 finite numbers, not all 0: the direction down in the ...

    """
    try:
        vector = np.asarray(direction, np.float64)
    except (TypeError, ValueError):
        vector = np.zeros(0)
    if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
        raise ValueError('gravity_camera must be 3 finite numbers, not all 0: the direction down '
                         f'in the optical frame, or None if it is not known; not {direction!r}')
    return unit_direction(vector / abs(vector).max())


def gravity_from_acceleration(acceleration: Sequence[float],
                              imu_to_camera: Sequence[float]) -> np.ndarray | None:
    """
    Return the direction of gravity from an accelerometer at rest.

    Parameters
    ----------
    acceleration : (3,) float
        ``sensor_msgs/Imu.linear_acceleration`` in m/s^2: at rest it points up (REP-145).
    imu_to_camera : (4,) float
        Quaternion x y z w that rotates vectors from the frame of the IMU into the optical frame;
        of any length except 0.

    Returns
    -------
    (3,) float64 or None
        Unit vector in the optical frame; None if the accelerometer is being moved.

    Examples
    --------
    >>> (gravity_from_acceleration((0.0, -9.8, 0.0), (0.0, 0.0, 0.0, 1.0)) + 0.0).tolist()
    [0.0, 1.0, 0.0]
    >>> gravity_from_acceleration((0.0, -15.0, 0.0), (0.0, 0.0, 0.0, 1.0)) is None
    True

    """
    force = np.asarray(acceleration, np.float64)
    strength = np.linalg.norm(force)
    if not abs(strength - _STANDARD_GRAVITY) <= _MAX_FORCE_ERROR_SHARE * _STANDARD_GRAVITY:
        return None
    mounting = RigidTransform.from_quaternion(imu_to_camera, np.zeros(3))
    return -mounting.points(force / strength)


def is_identity(quaternion: Sequence[float]) -> bool:
    """
    Return whether a quaternion x y z w, of any length, is no rotation.

    Examples
    --------
    >>> is_identity((0.0, 0.0, 0.0, -2.0)), is_identity((0.0, 0.0, 1.0, 1.0))
    (True, False)

    """
    return not any(quaternion[:3])


def smooth_gravity(previous: np.ndarray | None, reading: np.ndarray,
                   interval_s: float) -> np.ndarray:
    """Return the low-pass filtered unit direction (3,) after one more reading."""
    if previous is None:
        return reading
    gain = 1.0 - np.exp(-max(interval_s, 0.0) / _SMOOTHING_S)
    mixed = previous + gain * (reading - previous)
    length = np.linalg.norm(mixed)
    return mixed / length if length > 1e-6 else reading
