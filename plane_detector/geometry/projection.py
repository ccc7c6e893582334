# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Depth and intrinsics to points in the optical frame (REP-103: x right, y down, z forward)."""

from __future__ import annotations

import numpy as np

from plane_detector.geometry.disparity import limited_depth, valid_depth
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


def as_image(rgb: np.ndarray, intrinsics: CameraIntrinsics) -> np.ndarray:
    """
    Return an image (H, W, 3) uint8 in the form that kernels take: contiguous and writable.

    Raises
    ------
    ValueError
        It is not (H, W, 3) uint8, or its size differs from the intrinsics.

    Examples
    --------
    >>> camera = CameraIntrinsics(2.0, 2.0, 1.5, 0.5, 4, 2)
    >>> as_image(np.zeros((2, 4, 3), np.uint8)[:, ::-1], camera).flags.c_contiguous
    True
    >>> as_image(np.zeros((2, 4), np.uint8), camera)
    Traceback (most recent call last):
    ValueError: the image must be (H, W, 3) uint8, not (2, 4) uint8: of a grey one, np.dstack([...

    """
    rgb = np.asarray(rgb)
    if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != np.uint8:
        raise ValueError(f'the image must be (H, W, 3) uint8, not {rgb.shape} {rgb.dtype}: of a '
                         'grey one, np.dstack([grey] * 3); with a fourth channel, rgba[..., :3]; '
                         'from 0 to 1, (255 * image).astype(np.uint8)')
    _check_size('the image', rgb, intrinsics)
    return np.require(rgb, requirements='CW')


def as_depth(depth_m: np.ndarray, intrinsics: CameraIntrinsics, max_depth_m: float = np.inf,
             kind: str = 'z') -> np.ndarray:
    """
    Return measured depth in the form that the pipeline takes: z (H, W) float32, NaN invalid.

    Parameters
    ----------
    depth_m : (H, W) floating
        Metres; NaN, infinity and less than 1 mm are invalid, and so are masked values of a masked
        array.
    intrinsics : CameraIntrinsics
        Of an image of that size.
    max_depth_m : float
        Depth beyond this is invalid, too.
    kind : str
        ``z``: along the optical axis; ``ray``: the distance from the camera, along each ray.

    Raises
    ------
    ValueError
        It is not a 2-D floating point array, or its size differs from the intrinsics.

    Examples
    --------
    >>> camera = CameraIntrinsics(fx=1.0, fy=1.0, cx=0.0, cy=0.0, width=2, height=1)
    >>> as_depth(np.array([[2.0, 2.0]]), camera, kind='ray').round(3)
    array([[2.   , 1.414]], dtype=float32)
    >>> as_depth(np.array([[0.0, 9.0]]), camera, max_depth_m=8.0)
    array([[nan, nan]], dtype=float32)

    """
    depth_m = _checked_depth(depth_m, intrinsics)
    if kind == 'ray':
        with np.errstate(over='ignore', invalid='ignore'):
            depth_m = depth_m.astype(np.float32) / ray_lengths(intrinsics)
    return limited_depth(depth_m, max_depth_m)


def ray_lengths(intrinsics: CameraIntrinsics) -> np.ndarray:
    """
    Return the ratio of distance to depth of each pixel, (H, W) float32, at least 1.

    Examples
    --------
    >>> ray_lengths(CameraIntrinsics(3.0, 4.0, 0.0, 0.0, 5, 1)).round(3)
    array([[1.   , 1.054, 1.202, 1.414, 1.667]], dtype=float32)

    """
    ray_x, ray_y = pixel_rays(intrinsics)
    return np.sqrt(np.add.outer(1 + ray_y * ray_y, ray_x * ray_x))


def _checked_depth(depth_m: np.ndarray, intrinsics: CameraIntrinsics) -> np.ndarray:
    """Return depth (H, W) floating, NaN where it is masked; ValueError if it is not valid."""
    depth_m = np.asanyarray(depth_m)
    if depth_m.ndim != 2 or depth_m.dtype.kind != 'f':
        raise ValueError('depth must be a 2-D floating point array in metres, not '
                         f'{depth_m.ndim}-D {depth_m.dtype}; uint16 millimetres: divide by 1000')
    _check_size('depth', depth_m, intrinsics)
    return np.ma.filled(depth_m, np.nan)


def _check_size(what: str, image: np.ndarray, intrinsics: CameraIntrinsics) -> None:
    if not isinstance(intrinsics, CameraIntrinsics):
        raise ValueError('the intrinsics must be CameraIntrinsics, not '
                         f'{type(intrinsics).__name__}: of a matrix K, CameraIntrinsics(K[0, 0], '
                         'K[1, 1], K[0, 2], K[1, 2], width, height)')
    height, width = image.shape[:2]
    if (width, height) != (intrinsics.width, intrinsics.height):
        raise ValueError(f'{what} is {width} x {height}, the intrinsics are for '
                         f'{intrinsics.width} x {intrinsics.height}')


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
    depth_m = _checked_depth(depth_m, intrinsics)
    ray_x, ray_y = pixel_rays(intrinsics)
    points_m = np.empty((*depth_m.shape, 3), np.float32)
    points_m[..., 2] = depth_m
    points_m[~valid_depth(depth_m), 2] = np.nan
    np.multiply(points_m[..., 2], ray_x, out=points_m[..., 0])
    np.multiply(points_m[..., 2], ray_y[:, None], out=points_m[..., 1])
    return points_m
