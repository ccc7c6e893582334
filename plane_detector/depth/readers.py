# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Readers of network outputs: each kind of network has a reader that makes a Prediction.

A reader names the outputs that it needs, gets their arrays in this order, and knows their units,
axes and unknowns. Some readers need the intrinsics, so they are passed in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from plane_detector.depth.framing import Framing, rays
from plane_detector.depth.point_map import depth_from_point_map
from plane_detector.depth.preprocessing import finish_output
from plane_detector.types import CameraIntrinsics, Prediction

MIN_MASK = 0.5
"""Pixels are valid from this value of a validity mask, 0 to 1 (the threshold of MoGe)."""


class OutputError(ValueError):
    """The arrays of a network are not those that its reader expects."""


class Reader(Protocol):
    """
    Makes a prediction from the arrays of a network.

    Attributes
    ----------
    outputs : tuple of str
        Names of the outputs, in order; empty: the one that is the depth.
    kind : str
        ``metric_depth``, ``disparity`` or ``relative_disparity``.
    needs_lens : bool
        Whether it needs the intrinsics of the image.

    """

    outputs: tuple[str, ...]
    kind: str
    needs_lens: bool

    def values(self, arrays: Sequence[np.ndarray]) -> np.ndarray:
        """Return the values that encode depth, (h, w), unchanged; raise OutputError as `read`."""

    def read(self, arrays: Sequence[np.ndarray], framing: Framing,
             intrinsics: CameraIntrinsics | None) -> Prediction:
        """Return the prediction at the size of the image; raise OutputError for other arrays."""


@dataclass(frozen=True)
class DepthImageReader:
    """One depth or disparity image, in the unit of its kind."""

    kind: str
    outputs: tuple[str, ...] = ()
    needs_lens: bool = False

    def values(self, arrays: Sequence[np.ndarray]) -> np.ndarray:
        """Return the depth or disparity unchanged; see `Reader`."""
        return as_map(arrays[0])

    def read(self, arrays: Sequence[np.ndarray], framing: Framing,
             intrinsics: CameraIntrinsics | None) -> Prediction:
        """Return the prediction; see `Reader`."""
        raw = framing.crop(as_map(arrays[0]))
        return Prediction(
            self.kind, finish_output(raw, framing.image_size, self.kind))


@dataclass(frozen=True)
class CanonicalDepthReader:
    """
    Depth of a canonical camera, with normals and their confidence (Metric3D v2).

    The network assumes that every image is from a camera of ``canonical_focal_px``. Metres are its
    depth times the focal length at the size of its input over that one (Yin et al. 2023).
    """

    canonical_focal_px: float
    outputs: tuple[str, ...]
    kind: str = 'metric_depth'
    needs_lens: bool = True

    def values(self, arrays: Sequence[np.ndarray]) -> np.ndarray:
        """Return the depth unchanged; see `Reader`."""
        return as_map(arrays[0])

    def read(self, arrays: Sequence[np.ndarray], framing: Framing,
             intrinsics: CameraIntrinsics) -> Prediction:
        """Return metres and normals; see `Reader`."""
        raw = framing.crop(as_map(arrays[0])).astype(np.float32)
        depth_m = raw * np.float32(framing.focal_px(intrinsics) / self.canonical_focal_px)
        confidence = framing.crop(as_map(arrays[2])).astype(np.float32)
        return Prediction(
            self.kind, finish_output(depth_m, framing.image_size, self.kind),
            finish_normals(framing.crop(as_map(arrays[1], 3)), framing, intrinsics),
            framing.resized(confidence))


@dataclass(frozen=True)
class PointMapReader:
    """
    Points of unknown shift along z, with normals, a mask and a scale (MoGe-2).

    With known intrinsics, the shift is the one that brings the points onto the rays of their
    pixels; the scale then converts them to metres (Wang et al. 2025).
    """

    outputs: tuple[str, ...]
    kind: str = 'metric_depth'
    needs_lens: bool = True

    def values(self, arrays: Sequence[np.ndarray]) -> np.ndarray:
        """Return the distance of each point, which varies even on a wall seen frontally."""
        length = np.linalg.norm(as_map(arrays[0], 3), axis=-1)
        return np.where(as_map(arrays[2]) >= MIN_MASK, length, np.nan)

    def read(self, arrays: Sequence[np.ndarray], framing: Framing,
             intrinsics: CameraIntrinsics) -> Prediction:
        """Return metres and normals, NaN where the mask is below MIN_MASK; see `Reader`."""
        points, normals = (framing.crop(as_map(array, 3)).astype(np.float32)
                           for array in arrays[:2])
        is_valid = framing.crop(as_map(arrays[2])) >= MIN_MASK
        if arrays[3].size != 1:
            raise OutputError(f'its output {self.outputs[3]} is {arrays[3].shape}, not one number')
        depth = depth_from_point_map(points, is_valid, rays(intrinsics, points.shape[:2]))
        return Prediction(
            self.kind,
            finish_output(depth * np.float32(arrays[3].item()), framing.image_size, self.kind),
            finish_normals(np.where(is_valid[..., None], normals, np.float32(np.nan)), framing,
                           intrinsics))


def as_map(array: np.ndarray, channels: int = 1) -> np.ndarray:
    """
    Return an output as (h, w), or as (h, w, channels) from channels first or last.

    Raises
    ------
    OutputError
        It is not one image with the required number of channels.

    """
    image = array.squeeze()
    if channels == 1 and image.ndim == 2:
        return image
    if channels > 1 and image.ndim == 3:
        if image.shape[2] == channels:
            return image
        if image.shape[0] == channels:
            return image.transpose(1, 2, 0)
    many = f' of {channels} channels' if channels > 1 else ''
    raise OutputError(f'its output is {array.shape}, which is not one image{many}')


def finish_normals(raw: np.ndarray, framing: Framing, intrinsics: CameraIntrinsics) -> np.ndarray:
    """
    Resize normals to the image, with length 1 and pointing to the camera.

    Networks differ in the side that a normal points to, but each is consistent: if most normals
    point away from the camera, all are reversed.

    Parameters
    ----------
    raw : (h, w, 3) floating
        In the optical frame, of any length; NaN where invalid.
    framing : Framing
    intrinsics : CameraIntrinsics
        Of the image.

    Returns
    -------
    (H, W, 3) float32
        NaN where invalid.

    """
    normals = np.ascontiguousarray(framing.resized(np.ascontiguousarray(raw, np.float32)))
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    with np.errstate(invalid='ignore', divide='ignore'):
        normals = normals / length
    normals[~np.isfinite(normals).all(axis=-1)] = np.nan
    across = rays(intrinsics, normals.shape[:2])
    away = (normals[..., :2] * across).sum(axis=-1) + normals[..., 2]
    return -normals if np.nanmean(np.sign(away), dtype=float) > 0 else normals
