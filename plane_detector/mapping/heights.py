# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Planes as heights over the frames of the map's planes, and the difference of two of them.

A plane is h = a u + b v + c over the origin and the axes u, v of a frame, so the fusion of two
measurements is linear least squares, and their difference has three degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.types import Planes

# The weight of a plane halves at this chi-squared, three times the expected one (Cauchy).
ROBUST = 9.0


@dataclass(frozen=True)
class PlaneFrames:
    """Frames, and a plane as heights over each, stacked: M."""

    origins_m: np.ndarray  # (M, 3)
    axes: np.ndarray  # (M, 3, 3): rows u, v and normal
    coefficients: np.ndarray  # (M, 3): a, b, and c in metres
    covariances: np.ndarray  # (M, 3, 3)

    def __len__(self) -> int:
        return len(self.origins_m)

    def selected(self, index: np.ndarray | Sequence[int]) -> PlaneFrames:
        """Return some of them, in the order of the index."""
        return PlaneFrames(self.origins_m[index], self.axes[index], self.coefficients[index],
                           self.covariances[index])

    @property
    def coordinates(self) -> tuple[np.ndarray, np.ndarray]:
        """Normals (M, 3) and offsets (M,) of their planes."""
        _, normals, feet, _ = self._parts()
        return normals, -(normals * feet).sum(axis=1)

    def _parts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return slopes (M, 2), normals, points over origins, and lengths (M, 1) of normals."""
        slopes = self.coefficients[:, :2]
        length = np.sqrt(1 + (slopes * slopes).sum(axis=1))[:, None]
        normals = (self.axes[:, 2] - (slopes[:, None] @ self.axes[:, :2])[:, 0]) / length
        return slopes, normals, self.origins_m + self.coefficients[:, 2:] * self.axes[:, 2], length

    def as_planes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return normals (M, 3), offsets (M,) and covariances (M, 4, 4) of their planes."""
        slopes, normals, feet, length = self._parts()
        jacobian = np.zeros((len(self), 4, 3))
        jacobian[:, :3, :2] = -(self.axes[:, :2] / length[:, :, None]).transpose(0, 2, 1) - (
            normals[:, :, None] * slopes[:, None] / length[:, :, None] ** 2)
        jacobian[:, 3, :2] = -(feet[:, None] @ jacobian[:, :3, :2])[:, 0]
        jacobian[:, 3, 2] = -(normals * self.axes[:, 2]).sum(axis=1)
        return (normals, -(normals * feet).sum(axis=1),
                jacobian @ self.covariances @ jacobian.transpose(0, 2, 1))


def with_pose_error(planes: Planes, error: np.ndarray, centre_m: np.ndarray) -> Planes:
    """
    Add the error of a pose to the covariances of planes, see :func:`heights_of`.

    The centre is one (3,) for all, or one for each (K, 3).
    """
    jacobian = np.zeros((len(planes), 4, 6))
    x, y, z = planes.normals.T
    # A small rotation w changes the normal by w x n.
    jacobian[:, 0, 1], jacobian[:, 0, 2] = z, -y
    jacobian[:, 1, 0], jacobian[:, 1, 2] = -z, x
    jacobian[:, 2, 0], jacobian[:, 2, 1] = y, -x
    jacobian[:, 3, :3] = -(centre_m[..., None, :] @ jacobian[:, :3, :3])[:, 0]
    jacobian[:, 3, 3:] = -planes.normals
    return replace(planes, covariances=planes.covariances
                   + jacobian @ error @ jacobian.transpose(0, 2, 1))


NO_ERROR = np.zeros((6, 6))


def heights_of(frames: PlaneFrames, planes: Planes, index: np.ndarray,
               error: np.ndarray = NO_ERROR, centre_m: np.ndarray = NO_ERROR[0, :3]
               ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return planes as heights over frames.

    Parameters
    ----------
    frames : PlaneFrames
        M of them.
    planes : Planes
        In the frame that the origins are in.
    index : (M,) int
        The plane for each frame; it must not be perpendicular to the frame.
    error : (6, 6) float64
        Covariance of the pose of the planes: a small rotation about the centre, then a shift.
    centre_m : (3,) float64

    Returns
    -------
    coefficients : (M, 3) float64
    covariances : (M, 3, 3) float64
        With the error of the pose.
    jacobians : (M, 3, 6) float64
        Derivatives of the coefficients with respect to the pose. A point of the plane at u and v
        rises by N . (rotation x (p - centre) + shift), which is linear in u and v.

    """
    return _heights_of(frames.origins_m, frames.axes, planes.normals[index],
                       planes.offsets_m[index], planes.covariances[index], error, centre_m)


def squared_misfits(frames: PlaneFrames, heights: np.ndarray, covariances: np.ndarray
                    ) -> np.ndarray:
    """Return chi-squared (M,), three degrees of freedom, of measured heights of planes."""
    return _squared(heights - frames.coefficients, covariances + frames.covariances)


def normal_equations(frames: PlaneFrames, planes: Planes, index: np.ndarray,
                     camera: RigidTransform, centre_m: np.ndarray
                     ) -> tuple[np.ndarray, np.ndarray]:
    """
    Return information (6, 6) and gradient (6,) of a pose, from the misfits of its planes.

    Parameters
    ----------
    frames : PlaneFrames
        M of them.
    planes : Planes
        In the frame of the camera.
    index : (M,) int
        The plane for each frame.
    camera : RigidTransform
        The pose; its change is a small rotation about ``centre_m`` (3,), then a shift.
    centre_m : (3,) float64

    """
    return _normal_equations(
        (planes.normals[index], planes.offsets_m[index], planes.covariances[index]),
        (camera.rotation, camera.translation_m),
        (frames.origins_m, frames.axes, frames.coefficients, frames.covariances), centre_m)


_V, _M, _T = 'float64[:, ::1]', 'float64[:, :, ::1]', 'float64[::1]'


@kernel(f'Tuple(({_V}, {_M}, {_M}))({_V}, {_M}, {_V}, {_T}, {_M}, {_V}, {_T})', is_short=True)
def _heights_of(origins, axes, normals, offsets, covariances, error, centre):
    count = len(origins)
    heights, jacobians = np.empty((count, 3)), np.zeros((count, 3, 6))
    result, by_plane = np.empty((count, 3, 3)), np.empty((3, 4))
    half, half_pose = np.empty((3, 4)), np.empty((3, 6))
    for m in range(count):
        across = axes[m] @ normals[m]
        heights[m, 0], heights[m, 1] = -across[0] / across[2], -across[1] / across[2]
        heights[m, 2] = -(origins[m] @ normals[m] + offsets[m]) / across[2]
        for i in range(3):
            for j in range(3):
                start = origins[m, j] if i == 2 else axes[m, i, j]
                by_plane[i, j] = (-start - heights[m, i] * axes[m, 2, j]) / across[2]
            by_plane[i, 3] = -1.0 / across[2] if i == 2 else 0.0
        arm = origins[m] - centre
        for j in range(3):
            jacobians[m, 0, j], jacobians[m, 1, j] = -axes[m, 1, j], axes[m, 0, j]
            k, n = (j + 1) % 3, (j + 2) % 3
            jacobians[m, 2, j] = arm[k] * axes[m, 2, n] - arm[n] * axes[m, 2, k]
            jacobians[m, 2, 3 + j] = axes[m, 2, j]
        for i in range(3):
            for j in range(4):
                half[i, j] = 0.0
                for k in range(4):
                    half[i, j] += by_plane[i, k] * covariances[m, k, j]
            for j in range(6):
                half_pose[i, j] = 0.0
                for k in range(6):
                    half_pose[i, j] += jacobians[m, i, k] * error[k, j]
        for i in range(3):
            for j in range(3):
                total = 0.0
                for k in range(4):
                    total += half[i, k] * by_plane[j, k]
                for k in range(6):
                    total += half_pose[i, k] * jacobians[m, j, k]
                result[m, i, j] = total
    return heights, result, jacobians


@kernel(f'void({_V}, {_V})', is_short=True)
def _whiten(covariance, columns):
    """Replace columns (3, N) by L^-1 times them, for the factor L of a covariance (3, 3)."""
    c = covariance
    l11 = np.sqrt(c[0, 0])
    l21, l31 = c[1, 0] / l11, c[2, 0] / l11
    l22 = np.sqrt(c[1, 1] - l21 * l21)
    l32 = (c[2, 1] - l21 * l31) / l22
    l33 = np.sqrt(c[2, 2] - l31 * l31 - l32 * l32)
    for k in range(columns.shape[1]):
        columns[0, k] /= l11
        columns[1, k] = (columns[1, k] - l21 * columns[0, k]) / l22
        columns[2, k] = (columns[2, k] - l31 * columns[0, k] - l32 * columns[1, k]) / l33


@kernel(f'{_T}({_V}, {_M})', is_short=True)
def _squared(misfits, covariances):
    squared, column = np.empty(len(misfits)), np.empty((3, 1))
    for m in range(len(misfits)):
        column[:, 0] = misfits[m]
        _whiten(covariances[m], column)
        squared[m] = column[0, 0] ** 2 + column[1, 0] ** 2 + column[2, 0] ** 2
    return squared


@kernel(f'Tuple(({_V}, {_T}))(Tuple(({_V}, {_T}, {_M})), Tuple(({_V}, {_T})), '
        f'Tuple(({_V}, {_M}, {_V}, {_M})), {_T})', is_short=True)
def _normal_equations(planes, pose, frames, centre):
    (normals, offsets, covariances), (rotation, translation) = planes, pose
    origins, axes, coefficients, errors = frames
    # The planes under this pose, see Planes.moved.
    count, to_map = len(normals), np.zeros((4, 4))
    to_map[:3, :3], to_map[3, 3] = rotation, 1.0
    moved, shifted, moved_errors = np.empty((count, 3)), np.empty(count), np.empty((count, 4, 4))
    for j in range(3):
        to_map[3, j] = -(translation[0] * rotation[0, j] + translation[1] * rotation[1, j]
                         + translation[2] * rotation[2, j])
    for m in range(count):
        moved[m] = rotation @ normals[m]
        shifted[m] = offsets[m] - moved[m] @ translation
        moved_errors[m] = to_map @ covariances[m] @ to_map.T
    heights, height_errors, jacobians = _heights_of(
        origins, axes, moved, shifted, moved_errors, np.zeros((6, 6)), centre)
    information, gradient, columns = np.zeros((6, 6)), np.zeros(6), np.empty((3, 7))
    for m in range(count):
        columns[:, :6] = jacobians[m]
        columns[:, 6] = coefficients[m] - heights[m]
        _whiten(height_errors[m] + errors[m], columns)
        squared = columns[0, 6] ** 2 + columns[1, 6] ** 2 + columns[2, 6] ** 2
        for i in range(3):
            for j in range(6):
                weighted = columns[i, j] / (1 + squared / ROBUST)
                gradient[j] += weighted * columns[i, 6]
                for k in range(6):
                    information[j, k] += weighted * columns[i, k]
    return information, gradient
