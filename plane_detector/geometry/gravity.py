# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Direction of gravity in the optical frame, from settings or from an IMU."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from plane_detector.geometry.rigid_transform import RigidTransform

_STANDARD_GRAVITY = 9.80665  # m/s^2
# A larger deviation of the mean force means that the force is not gravity.
_MAX_FORCE_ERROR_SHARE = 0.1
# chosen: steps and bumps of robots take less than half a second; an error of .01 rad/s in the
# angular velocities rotates the mean of two seconds by 1 degree.
_AVERAGED_S, _AVERAGED_TURNING_S = 0.5, 2.0
_SILENT_IMU_S = 1.0
_JOLT_M_S2 = 0.5 * _STANDARD_GRAVITY  # chosen: above the vibration of a robot that keeps rolling
# chosen: half of the vibration that moves gravity by more than 5 degrees while it lasts.
_SHAKEN_M_S2 = 1.0
# chosen: planes within 10 degrees are level; a tenth of the image is not a lamp, and a hundredth
# of it shows the floor. 12 degrees off level, a camera is on its side rather than upside down.
_LEVEL_COSINE, _LEAST_CEILING, _LEAST_FLOOR, _UPSIDE_DOWN = math.cos(math.radians(10)), .1, .01, .2
_NEAR_CEILING_M = 1.5  # chosen: below the height of a room above a camera that looks up


def unit_direction(direction: Sequence[float] | np.ndarray) -> np.ndarray | None:
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


def measured_direction(direction: Sequence[float] | np.ndarray) -> np.ndarray:
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


def is_identity(quaternion: Sequence[float]) -> bool:
    """
    Return whether a quaternion x y z w, of any length, is the identity rotation.

    Examples
    --------
    >>> is_identity((0.0, 0.0, 0.0, -2.0)), is_identity((0.0, 0.0, 1.0, 1.0))
    (True, False)

    """
    return not any(quaternion[:3])


def sign_question(gravity_camera: np.ndarray, normals: np.ndarray, offsets_m: np.ndarray,
                  counts: np.ndarray, pixels: int) -> str:
    """
    Return that measured gravity may point up, and the remedy; empty without evidence.

    According to it, the camera is upside down and sees a ceiling, but no level surface below; or
    it looks up, and the ceiling is near. That is rare, but it is what a floor looks like if the
    sign is inverted.

    Parameters
    ----------
    gravity_camera : (3,) float64
        Unit direction down in the optical frame.
    normals, offsets_m, counts : (K, 3), (K,), (K,)
        Of the planes, in metres or NaN if their unit is not known.
    pixels : int
        Of the image.

    """
    up = -(normals @ gravity_camera)  # 1: a floor, -1: a ceiling
    shares = counts / pixels
    if not (shares[up < -_LEVEL_COSINE] >= _LEAST_CEILING).any():
        return ''
    if (shares[up > _LEVEL_COSINE] >= _LEAST_FLOOR).any():
        return ''
    ceiling = int(np.where(up < -_LEVEL_COSINE, shares, 0).argmax())
    is_upside_down = gravity_camera[1] < -_UPSIDE_DOWN
    looks_up = gravity_camera[2] < -_UPSIDE_DOWN and offsets_m[ceiling] < _NEAR_CEILING_M
    if not (is_upside_down or looks_up):
        return ''
    how = 'is upside down' if is_upside_down else 'looks up'
    return (f'by the measured gravity the camera {how} and sees a ceiling '
            f'{offsets_m[ceiling]:.2f} m above it, but no floor: if that is a floor, the sign is '
            'inverted; at rest linear_acceleration points up, away from the earth (REP-145), and '
            'gravity_camera down')


class GravityFilter:
    """
    The direction of gravity from an IMU, averaged over time.

    A moving accelerometer measures gravity and its own acceleration, whose mean over time is
    small. Without angular velocities the mean is over half a second; with them it rotates with the
    IMU, as in a complementary filter, and is over four times as long.

    Parameters
    ----------
    imu_to_camera : (4,) float
        Quaternion x y z w that rotates vectors from the frame of the IMU into the optical frame;
        of any length except 0.

    Examples
    --------
    >>> imu = GravityFilter((0.0, 0.0, 0.0, 1.0))
    >>> imu.add(0.0, (0.0, -9.8, 0.0))
    >>> imu.gravity_camera(0.1) + 0.0, imu.problem
    (array([0., 1., 0.]), '')
    >>> imu.reset()
    >>> for k in range(40):
    ...     imu.add(0.02 * k, (0.0, -1.0, 0.0))
    >>> imu.problem
    'the linear_acceleration of the IMU is 1.00 long at rest, ...'

    """

    def __init__(self, imu_to_camera: Sequence[float]) -> None:
        self._imu_to_camera = imu_to_camera
        self.reset()

    def mount(self, imu_to_camera: Sequence[float]) -> None:
        """Change the mounting of the IMU; readings with another mounting are discarded."""
        if tuple(imu_to_camera) != tuple(self._imu_to_camera):
            self._imu_to_camera = imu_to_camera
            self.reset()

    def reset(self) -> None:
        """Discard all readings."""
        self._force: np.ndarray | None = None  # mean, in the frame of the IMU, m/s^2
        self._spread2 = 0.0  # mean square of the deviations from it
        self._stamp_s = -math.inf
        self._averaged_s = 0.0
        self._has_turned = False
        self._fault = ''

    def add(self, stamp_s: float, acceleration: Sequence[float],
            angular_velocity: Sequence[float] | None = None) -> None:
        """Add a reading: (x, y, z) in m/s^2, at rest pointing up (REP-145), and in rad/s."""
        force = np.asarray(acceleration, np.float64)
        if not np.isfinite(force).all():
            self._fault = f'the linear_acceleration of the IMU is not finite: {force.tolist()}'
            return
        if not force.any():
            self._fault = ('the linear_acceleration of the IMU is all zeros: it has no '
                           'accelerometer, or its driver does not fill it')
            return
        self._fault = ''
        interval_s = stamp_s - self._stamp_s
        if self._force is None or not -_SILENT_IMU_S <= interval_s <= _SILENT_IMU_S:
            self._force, self._spread2, self._averaged_s = force, 0.0, 0.0
            self._stamp_s = stamp_s
            return
        is_jolt = abs(np.linalg.norm(force) - _STANDARD_GRAVITY) > _JOLT_M_S2
        if interval_s <= 0 or (is_jolt and self._is_weight):
            return
        # Zeros mean a driver without a gyroscope, until a reading shows a rotation.
        turns = angular_velocity is not None and np.isfinite(angular_velocity).all()
        self._has_turned |= turns and np.any(angular_velocity)
        if turns:  # a direction fixed in the world rotates against the IMU
            self._force = cv2.Rodrigues(-interval_s * np.asarray(angular_velocity, float))[0] @ (
                self._force)
        most_s = _AVERAGED_TURNING_S if turns and self._has_turned else _AVERAGED_S
        # The mean of all readings until they fill the time, because the first one may be a jerk.
        self._averaged_s = min(self._averaged_s + interval_s, most_s)
        gain = interval_s / (self._averaged_s + interval_s)
        deviation = force - self._force
        self._spread2 += gain * (float(deviation @ deviation) - self._spread2)
        self._force = self._force + gain * deviation
        self._stamp_s = stamp_s

    def gravity_camera(self, stamp_s: float) -> np.ndarray | None:
        """Return the direction of gravity (3,), optical frame; None without recent readings."""
        if stamp_s - self._stamp_s > _SILENT_IMU_S or self._force is None or not self._is_weight:
            return None
        mounting = RigidTransform.from_quaternion(self._imu_to_camera, np.zeros(3))
        return -mounting.points(self._force / np.linalg.norm(self._force))

    @property
    def _is_weight(self) -> bool:
        return (abs(np.linalg.norm(self._force) - _STANDARD_GRAVITY)
                <= _MAX_FORCE_ERROR_SHARE * _STANDARD_GRAVITY)

    @property
    def problem(self) -> str:
        """The problem with the readings, and the remedy; empty if there is none."""
        if self._fault or self._force is None:
            return self._fault and f'{self._fault}; gravity is not taken from it'
        strength, shaken = float(np.linalg.norm(self._force)), math.sqrt(self._spread2)
        if self._averaged_s >= _AVERAGED_S / 2 and not self._is_weight:
            is_in_g = abs(strength - 1) <= _MAX_FORCE_ERROR_SHARE
            remedy = ('it is in g, and must be in m/s^2 (REP-145)' if is_in_g else
                      'calibrate it, or make its driver publish acceleration with gravity, in '
                      'm/s^2')
            return (f'the linear_acceleration of the IMU is {strength:.2f} long at rest, not '
                    f'{_STANDARD_GRAVITY:.2f} m/s^2: {remedy}; gravity is not taken from it')
        if shaken > _SHAKEN_M_S2:
            return (f'the IMU is shaken by {shaken:.1f} m/s^2: gravity is the mean of '
                    f'{self._averaged_s:.1f} s; mount it softly, or use base_frame or '
                    'scale.gravity')
        return ''
