# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Depth and intrinsics to points in the optical frame (REP-103: x right, y down, z forward)."""

from __future__ import annotations

import numpy as np

from plane_detector.geometry.disparity import valid_depth
from plane_detector.types import CameraIntrinsics


def pixel_rays(intrinsics: CameraIntrinsics) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the slopes x/z of each column (W,) and y/z of each row (H,), float32.

    The pinhole model: x/z = (u - cx) / fx, y/z = (v - cy) / fy.

    Examples
    --------
    >>> pixel_rays(CameraIntrinsics(2.0, 2.0, 1.0, 0.0, 3, 2))
    (array([-0.5,  0. ,  0.5], dtype=float32), array([0. , 0.5], dtype=float32))

    """
    ray_x = (np.arange(intrinsics.width) - intrinsics.cx) / intrinsics.fx
    ray_y = (np.arange(intrinsics.height) - intrinsics.cy) / intrinsics.fy
    return ray_x.astype(np.float32), ray_y.astype(np.float32)


def check_image(rgb: np.ndarray, intrinsics: CameraIntrinsics) -> None:
    """
    Check type and size of an image.

    Raises
    ------
    ValueError
        It is not (H, W, 3) uint8, or its size differs from the intrinsics.

    Examples
    --------
    >>> check_image(np.zeros((2, 4, 3), np.uint8), CameraIntrinsics(2.0, 2.0, 1.5, 0.5, 4, 2))

    """
    if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != np.uint8:
        raise ValueError(f'the image must be (H, W, 3) uint8, not {rgb.shape} {rgb.dtype}')
    if rgb.shape[:2] != (intrinsics.height, intrinsics.width):
        raise ValueError(f'the image is {rgb.shape[1]} x {rgb.shape[0]}, the intrinsics are for '
                         f'{intrinsics.width} x {intrinsics.height}')


def check_depth(depth_m: np.ndarray, intrinsics: CameraIntrinsics) -> None:
    """
    Check type and size of a depth image.

    Raises
    ------
    ValueError
        It is not a 2-D floating point array, or its size differs from the intrinsics.

    """
    if depth_m.ndim != 2 or depth_m.dtype.kind != 'f':
        raise ValueError('depth must be a 2-D floating point array in metres, not '
                         f'{depth_m.ndim}-D {depth_m.dtype}; uint16 millimetres: divide by 1000')
    if depth_m.shape != (intrinsics.height, intrinsics.width):
        raise ValueError(f'depth is {depth_m.shape[1]} x {depth_m.shape[0]}, the intrinsics are '
                         f'for {intrinsics.width} x {intrinsics.height}')


def depth_to_points(depth_m: np.ndarray, intrinsics: CameraIntrinsics) -> np.ndarray:
    """
    Back-project a depth image.

    Parameters
    ----------
    depth_m : (H, W) floating
        Depth along the optical axis in metres; not finite or less than 1 mm is invalid.
    intrinsics : CameraIntrinsics
        Of the same image.

    Returns
    -------
    (H, W, 3) float32
        Points in metres, NaN where the depth is invalid.

    Raises
    ------
    ValueError
        Sizes of depth and intrinsics differ.

    Examples
    --------
    >>> camera = CameraIntrinsics(fx=1.0, fy=1.0, cx=1.0, cy=0.0, width=3, height=1)
    >>> depth_to_points(np.array([[2.0, np.nan, 2.0]]), camera)[0]
    array([[-2.,  0.,  2.],
           [nan, nan, nan],
           [ 2.,  0.,  2.]], dtype=float32)

    """
    check_depth(depth_m, intrinsics)
    ray_x, ray_y = pixel_rays(intrinsics)
    points_m = np.empty((*depth_m.shape, 3), np.float32)
    points_m[..., 2] = depth_m
    points_m[~valid_depth(depth_m), 2] = np.nan
    np.multiply(points_m[..., 2], ray_x, out=points_m[..., 0])
    np.multiply(points_m[..., 2], ray_y[:, None], out=points_m[..., 1])
    return points_m
