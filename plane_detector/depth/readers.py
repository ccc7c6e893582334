# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Meaning of the outputs of networks: what each output is, its unit, and for which lens.

References
----------
W. Yin et al.: Metric3D, Towards Zero-Shot Metric 3D Prediction from a Single Image, 2023.
R. Wang et al.: MoGe-2, Accurate Monocular Geometry with Metric Scale and Sharp Details, 2025.

"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from plane_detector.depth.preprocessing import Framing, finish_output, rays
from plane_detector.types import CameraIntrinsics, Prediction

# Channels of the outputs by their roles in `Outputs`; 0: one number.
_CHANNELS = {'depth': 1, 'points': 3, 'mask': 1, 'scale': 0, 'normals': 3, 'confidence': 1}
_MIN_MASK = 0.5  # pixels are valid from this value of a mask (the threshold of MoGe)
_ROUNDS = 20
_SETTLED = 1e-6  # of the depth: below the precision of float32
_SAMPLED_SIDE = 64  # chosen: 4096 pixels determine one unknown with more than enough precision
_MIN_DEPTH_SHARE = 0.01  # of the typical depth; nearer pixels would dominate the weights
OWN_FOCAL = -1.0


class OutputError(ValueError):
    """The arrays of a network do not match its table of outputs."""


@dataclass(frozen=True)
class Outputs:
    """Names of a network's outputs by their meaning; empty for what it does not provide."""

    kind: str  # as in `plane_detector.types.Prediction`
    # One image in the unit of the kind. If no output is named, the only one, or the only one with
    # depth or disp in its name, is the depth.
    depth: str = ''
    # The depth is that of a camera with this focal length; metres are the depth times the focal
    # length at the size of the input over this one (Yin 2023). 0: the depth is in metres.
    canonical_focal_px: float = 0.0
    # x, y, z with an unknown shift along z, in the unit of ``scale``; valid where ``mask`` is at
    # least _MIN_MASK. The shift brings them onto the rays of their pixels (Wang 2025).
    points: str = ''
    mask: str = ''  # validity of the points, 0 to 1
    scale: str = ''  # one number, metres per unit of the points
    normals: str = ''  # in the optical frame, all toward the camera or all away from it
    confidence: str = ''  # of the normals
    is_indoor: bool = False  # trained on indoor images only

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the outputs; empty: the one that is the depth."""
        return tuple(name for role in _CHANNELS if (name := getattr(self, role)))

    @property
    def needs_lens(self) -> bool:
        """Whether the intrinsics of the image are needed."""
        return bool(self.canonical_focal_px or self.points or self.normals)

    def maps(self, arrays: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
        """Return the arrays of the network (h, w) or (h, w, 3) by role; may raise OutputError."""
        roles = [role for role in _CHANNELS if getattr(self, role)] or ['depth']
        return {role: _as_map(array, _CHANNELS[role])
                for role, array in zip(roles, arrays, strict=True)}

    def raw(self, arrays: Sequence[np.ndarray]) -> np.ndarray:
        """Return the values that encode the depth, (h, w), unchanged; may raise OutputError."""
        maps = self.maps(arrays)
        if not self.points:
            return maps['depth']
        # The distance of each point, which varies even on a wall seen frontally.
        length = np.linalg.norm(maps['points'], axis=-1)
        return np.where(maps['mask'] >= _MIN_MASK, length, np.nan)

    def read(self, arrays: Sequence[np.ndarray], framing: Framing,
             intrinsics: CameraIntrinsics | None) -> Prediction:
        """Return the prediction of the arrays, in the order of `names`; may raise OutputError."""
        maps = self.maps(arrays)
        scale = maps.pop('scale', None)
        maps = {role: framing.crop(values) for role, values in maps.items()}
        normals = confidence = None
        is_valid = maps['mask'] >= _MIN_MASK if self.mask else None
        if self.points:
            points = maps['points'].astype(np.float32)
            depth = depth_from_point_map(points, is_valid, rays(intrinsics, points.shape[:2]))
            depth = depth * np.float32(scale)
        else:
            depth = maps['depth']
        if self.canonical_focal_px:
            depth = depth.astype(np.float32) * np.float32(
                framing.focal_px(intrinsics) / self.canonical_focal_px)
        if self.normals:
            normals = maps['normals'].astype(np.float32)
            if self.mask:
                normals = np.where(is_valid[..., None], normals, np.float32(np.nan))
            normals = _finished_normals(normals, framing, intrinsics)
        if self.confidence:
            confidence = framing.resized(maps['confidence'].astype(np.float32))
        return Prediction(self.kind, finish_output(depth, framing.image_size, self.kind), normals,
                          confidence, self.is_indoor)


def _as_map(array: np.ndarray, channels: int) -> np.ndarray:
    """Return an output as (h, w), as (h, w, 3) from channels first or last, or as a number."""
    image = array.squeeze()
    if channels == 1 and image.ndim == 2:
        return image
    if channels == 3 and image.ndim == 3 and 3 in (image.shape[0], image.shape[2]):
        return image if image.shape[2] == 3 else image.transpose(1, 2, 0)
    if channels == 0 and image.size == 1:
        return image
    what = ('one number', 'one image', '', 'one image of 3 channels')[channels]
    raise OutputError(f'its output is {array.shape}, which is not {what}')


def _finished_normals(raw: np.ndarray, framing: Framing,
                      intrinsics: CameraIntrinsics) -> np.ndarray:
    """
    Return normals (h, w, 3) resized to the image, of length 1 and pointing toward the camera.

    Networks differ in the direction of normals, but each is consistent: if most normals point away
    from the camera, all are reversed.
    """
    normals = np.ascontiguousarray(framing.resized(np.ascontiguousarray(raw)))
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    with np.errstate(invalid='ignore', divide='ignore'):
        normals = normals / length
    normals[~np.isfinite(normals).all(axis=-1)] = np.nan
    across = rays(intrinsics, normals.shape[:2])
    away = (normals[..., :2] * across).sum(axis=-1) + normals[..., 2]
    return -normals if np.nanmean(np.sign(away), dtype=float) > 0 else normals


def depth_from_point_map(points: np.ndarray, is_valid: np.ndarray,
                         rays: np.ndarray) -> np.ndarray:
    """
    Return z + t of a point map whose shift t along the optical axis is unknown.

    The point (x, y, z) of a pixel with ray (r, 1) must satisfy (x, y) = (z + t) r, which is linear
    in t. Each pixel is weighted by 1 / (z + t)**2, which turns its error into one in the image:
    t = sum w (r . (x, y) - |r|**2 z) / sum w |r|**2, until it converges. Points are (h, w, 3),
    rays x / z and y / z of each pixel, (h, w, 2); the result is NaN where invalid.
    """
    is_valid = is_valid & np.isfinite(points).all(axis=-1)
    thin = tuple(slice(None, None, max(1, side // _SAMPLED_SIDE)) for side in points.shape[:2])
    shift = _shift(points[thin][is_valid[thin]].astype(float),
                   rays[thin][is_valid[thin]].astype(float))
    return np.where(is_valid, points[..., 2] + np.float32(shift), np.float32(np.nan))


def _shift(points: np.ndarray, rays: np.ndarray) -> float:
    """Return t for points (n, 3) on rays (n, 2); 0 if it cannot be determined."""
    square = (rays**2).sum(axis=1)
    if not square.any():
        return 0.0
    z = points[:, 2]
    difference = (rays * points[:, :2]).sum(axis=1) - square * z
    shift = float(difference.sum() / square.sum())
    for _ in range(_ROUNDS):
        depth = z + shift
        typical = np.median(np.abs(depth))
        weight = 1 / np.maximum(depth, _MIN_DEPTH_SHARE * typical + 1e-12) ** 2
        before, shift = shift, float((weight * difference).sum() / (weight * square).sum())
        if abs(shift - before) < _SETTLED * typical:
            break
    return shift


def lens_factor(intrinsics: CameraIntrinsics, reference_focal_px: float,
                focal_per_height: float) -> float:
    """
    Return the factor that corrects the metres of a network for the focal length of the camera.

    Metric networks assume the camera that they were trained with. With a longer lens, objects
    appear nearer by the ratio of the focal lengths (the canonical camera of Yin 2023).

    Parameters
    ----------
    intrinsics : CameraIntrinsics
        Of the image.
    reference_focal_px : float
        Focal length that the network assumes, at the width of the image; 0: no correction;
        OWN_FOCAL: the focal length that the network is known to be trained with.
    focal_per_height : float
        Focal length over image height that the network is known to be trained with; 0: unknown.

    Returns
    -------
    float
        1 if no correction is needed or the focal length is unknown.

    """
    if reference_focal_px > 0:
        return intrinsics.fx / reference_focal_px
    if reference_focal_px == OWN_FOCAL and focal_per_height > 0:
        return intrinsics.fy / intrinsics.height / focal_per_height
    return 1.0
