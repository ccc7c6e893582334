# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Direction of gravity from the readings of an accelerometer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from plane_detector.geometry.gravity import gravity_from_acceleration, smooth_gravity

_SILENT_S = 1.0


class GravityFilter:
    """
    Smooths readings over time; readings during acceleration are ignored.

    Parameters
    ----------
    imu_to_camera : (4,) float
        Quaternion x y z w that rotates vectors from the frame of the IMU into the optical frame.

    """

    def __init__(self, imu_to_camera: Sequence[float]):
        self._imu_to_camera = imu_to_camera
        self.reset()

    def mount(self, imu_to_camera: Sequence[float]) -> None:
        """Change the mounting of the IMU; readings by another one are discarded."""
        if tuple(imu_to_camera) != tuple(self._imu_to_camera):
            self._imu_to_camera = imu_to_camera
            self.reset()

    def reset(self) -> None:
        """Discard all readings."""
        self._gravity_camera: np.ndarray | None = None
        self._stamp_s = -np.inf

    def add(self, stamp_s: float, acceleration: Sequence[float]) -> None:
        """Add a reading (x, y, z) in m/s^2."""
        reading = gravity_from_acceleration(acceleration, self._imu_to_camera)
        if reading is None:
            return
        if stamp_s < self._stamp_s - _SILENT_S:
            self.reset()
        interval_s = min(stamp_s - self._stamp_s, 1e3)
        self._gravity_camera = smooth_gravity(self._gravity_camera, reading, interval_s)
        self._stamp_s = stamp_s

    def gravity_camera(self, stamp_s: float) -> np.ndarray | None:
        """Return the unit direction (3,) in the optical frame; None without recent readings."""
        return self._gravity_camera if stamp_s - self._stamp_s <= _SILENT_S else None
