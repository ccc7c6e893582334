# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Recognition of depth images that contain the distance along each ray instead of the depth z.

Along the ray (x, y, 1) the distance is z s, with s = sqrt(1 + x^2 + y^2). On a plane 1/z is linear
in the pixel, so the inverse of the image value is a linear function times s^-k: k is 0 for depth
and 1 for distance, whatever the plane. In each part of the image, ln s is therefore fitted
together with a linear function; parts that are not planes give arbitrary k, mostly with a large
error. A single ball that fills the image at the distance of its radius looks like a wall in
distances along the rays.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from plane_detector.geometry.projection import ray_lengths
from plane_detector.types import CameraIntrinsics

# chosen: means of square cells of a 60th of the shorter side, and parts of 8 x 8 and 16 x 16 of
# them, overlapping by half: small ones for cluttered rooms, large ones for noise.
_CELLS, _PARTS = 60, (8, 16)
_LEAST_VALID = 0.8  # chosen: of the cells of a part
# chosen: a part counts if k has a smaller standard deviation than this; it indicates 0 or 1 if k
# is within twice that.
_MOST_SIGMA, _NEAR = 0.15, 0.3
# tuned: of 347 images of 15 depth sensors none is mistaken for the other kind; where six parts
# count, at most .22 of them indicate it. Converted to distances, 230 of them are recognised, to
# depth 247; most of the others have fewer than six parts that count.
_LEAST_COUNT, _LEAST_SHARE, _MOST_AGAINST = 6, 0.5, 0.1


def kind_note(depth_m: np.ndarray, intrinsics: CameraIntrinsics, kind: str) -> str:
    """
    Return that a depth image is not of the stated kind, and the remedy; empty if unclear.

    Parameters
    ----------
    depth_m : (H, W) float32
        Depth according to the stated kind, NaN invalid: for ``ray``, the given values over the
        length of each ray.
    intrinsics : CameraIntrinsics
    kind : str
        ``z`` or ``ray``.

    """
    other = 1.0 if kind == 'z' else -1.0
    for exponents in _exponents(depth_m, intrinsics):
        share = float((abs(exponents - other) < _NEAR).mean()) if exponents.size else 0.0
        against = float((abs(exponents) < _NEAR).mean()) if exponents.size else 0.0
        if (exponents.size >= _LEAST_COUNT and share >= _LEAST_SHARE
                and against <= _MOST_AGAINST):
            parts = f'{round(share * exponents.size)} of {exponents.size} parts of the image'
            if kind == 'z':
                return (f'the depth is the distance from the camera along each ray, not along the '
                        f'optical axis: {parts} are plane only as such; set depth.kind to ray')
            return ('the depth is along the optical axis, not the distance along each ray: '
                    f'{parts} are plane only as such; set depth.kind to z')
    return ''


def _exponents(depth_m: np.ndarray, intrinsics: CameraIntrinsics) -> list[np.ndarray]:
    """Return k of the parts of each size that determine it, (N,) each."""
    cell = max(1, min(depth_m.shape) // _CELLS)
    inverse = _means(1 / depth_m, cell)
    log_lengths = _log_lengths(intrinsics, cell)
    return [_fitted(inverse, log_lengths, side) for side in _PARTS
            if side <= min(inverse.shape)]


@lru_cache(maxsize=8)
def _log_lengths(intrinsics: CameraIntrinsics, cell: int) -> np.ndarray:
    """Return the mean of ln s in each cell: always the same for one camera."""
    means = _means(np.log(ray_lengths(intrinsics)), cell)
    means.flags.writeable = False
    return means


def _means(image: np.ndarray, cell: int) -> np.ndarray:
    """Return the mean of each cell, float64; NaN where a pixel is."""
    rows, columns = image.shape[0] // cell, image.shape[1] // cell
    return image[:rows * cell, :columns * cell].reshape(rows, cell, columns, cell).mean(
        axis=(1, 3), dtype=np.float64)


def _fitted(inverse: np.ndarray, log_lengths: np.ndarray, side: int) -> np.ndarray:
    """Return k of each part, ``side`` cells wide and high, that determines it, (N,)."""
    values, logs = (np.lib.stride_tricks.sliding_window_view(image, (side, side))[
        ::side // 2, ::side // 2].reshape(-1, side * side) for image in (inverse, log_lengths))
    valid = np.isfinite(values)
    is_kept = valid.mean(axis=1) >= _LEAST_VALID
    values, logs, valid = np.nan_to_num(values[is_kept]), logs[is_kept], valid[is_kept]
    row, column = np.indices((side, side)).reshape(2, -1) - (side - 1) / 2
    basis = np.stack([np.ones_like(row), column, row], axis=1) * valid[:, :, None]
    products = np.swapaxes(basis, 1, 2) @ basis

    def linear(given: np.ndarray) -> np.ndarray:
        return (basis @ np.linalg.solve(
            products, np.swapaxes(basis, 1, 2) @ given[:, :, None]))[:, :, 0]
    plane = linear(values)
    # v = plane (1 - k (ln s - its mean)), to first order in the variation of ln s in the part.
    bend = plane * (logs - logs.mean(axis=1, keepdims=True)) * valid
    bend, rest = bend - linear(bend), values - plane
    with np.errstate(divide='ignore', invalid='ignore'):
        strength = (bend * bend).sum(axis=1)
        exponents = -(bend * rest).sum(axis=1) / strength
        left = rest + exponents[:, None] * bend
        sigmas = np.sqrt((left * left).sum(axis=1) / (valid.sum(axis=1) - 4) / strength)
        return exponents[sigmas < _MOST_SIGMA]
