# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Photographs of the demo and their calibration: from libraries, or the user's own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from plane_detector.geometry.rectification import Reduction
from plane_detector.types import MOST_FIELD_OF_VIEW_DEG, CameraIntrinsics

# Horizontal field of view for images without calibration, typical of phones and webcams.
_FIELD_OF_VIEW_DEG = 60.0
# Larger images are reduced: a labelled cloud of 4000 x 3000 points takes 240 MB per frame.
_LONGEST_SIDE_PX = 800
# Downward direction in the workshop, from its floor in measured depth. A robot gets it from TF or
# an IMU; the small network sees too little in this image to estimate it.
WORKSHOP_GRAVITY = (-0.01, 0.97, 0.26)
_SUFFIXES = ('.bmp', '.jpeg', '.jpg', '.png', '.tif', '.tiff', '.webp')


@dataclass(frozen=True)
class Lens:
    """Calibration of a camera, for images of full size; contradictions raise ValueError."""

    fx: float | None = None  # pixels; without it the camera is uncalibrated
    fy: float | None = None  # default: fx
    cx: float | None = None  # default: the centre of the image
    cy: float | None = None
    field_of_view_deg: float | None = None  # horizontal, of an uncalibrated camera

    def __post_init__(self) -> None:
        others = (self.fy, self.cx, self.cy)
        if self.fx is None and any(value is not None for value in others):
            raise ValueError('fy, cx and cy require fx')
        if self.fx is not None and self.field_of_view_deg is not None:
            raise ValueError('either fx or a field of view, not both')
        if (self.field_of_view_deg is not None
                and not 1 <= self.field_of_view_deg <= MOST_FIELD_OF_VIEW_DEG):
            raise ValueError(f'the field of view must be from 1 to {MOST_FIELD_OF_VIEW_DEG:g} '
                             f'degrees, not {self.field_of_view_deg:g}')

    def intrinsics(self, width: int, height: int) -> CameraIntrinsics:
        """Return the pinhole model for an image of this size."""
        if self.fx is None:
            return CameraIntrinsics.from_field_of_view(
                width, height, self.field_of_view_deg or _FIELD_OF_VIEW_DEG, is_guessed=True)
        return CameraIntrinsics(
            self.fx, self.fx if self.fy is None else self.fy,
            (width - 1) / 2 if self.cx is None else self.cx,
            (height - 1) / 2 if self.cy is None else self.cy, width, height)

    def __str__(self) -> str:
        if self.fx is not None:
            return 'calibration as given'
        if self.field_of_view_deg is not None:
            return f'uncalibrated, field of view {self.field_of_view_deg:g} degrees as given'
        return f'uncalibrated, field of view assumed to be {_FIELD_OF_VIEW_DEG:g} degrees'


@dataclass(frozen=True)
class Photograph:
    """An image, its camera, and the true depth if known."""

    name: str  # also used as name of the result files
    rgb: np.ndarray  # (H, W, 3) uint8
    intrinsics: CameraIntrinsics
    calibration: str  # readable source of the intrinsics
    true_depth_m: np.ndarray | None = None  # (H, W) float32 or None; NaN where unknown


def own_images(source: Path, lens: Lens) -> list[Photograph]:
    """
    Return an image, or the images of a folder, reduced to `_LONGEST_SIDE_PX` if larger.

    Raises
    ------
    FileNotFoundError
        There is no such file or folder, or no image in the folder.
    ValueError
        An image cannot be read.

    """
    if not source.exists():
        raise FileNotFoundError(f'there is no image or folder {source}')
    paths = [source] if source.is_file() else sorted(
        path for path in source.iterdir() if path.suffix.lower() in _SUFFIXES)
    if not paths:
        raise FileNotFoundError(f'no image in {source}: looked for *{", *".join(_SUFFIXES)}')
    stems = [path.stem for path in paths]
    return [_photograph(path, path.stem if stems.count(path.stem) == 1 else path.name, lens)
            for path in paths]


def _photograph(path: Path, name: str, lens: Lens) -> Photograph:
    bgr = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if bgr is None:
        raise ValueError(f'{path} cannot be read as an image')
    height, width = bgr.shape[:2]
    reduction = Reduction.to_side((width, height), _LONGEST_SIDE_PX)
    return Photograph(
        name, reduction.image(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)),
        reduction.camera(lens.intrinsics(width, height)),
        f'{lens}{"" if reduction.is_none else f", shrunk from {width} x {height}"}')


def workshop() -> Photograph:
    """
    Return the motorcycle in a workshop of scikit-image, with true disparity and calibration.

    Middlebury 2014 stereo, Scharstein et al.: z = fx * baseline / (disparity + doffs).
    """
    try:
        from skimage.data import stereo_motorcycle
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError('the demo\'s image stereo_motorcycle is in scikit-image: '
                                  'pip install scikit-image') from error
    fx_px, baseline_m, doffs_px = 994.978, 0.193001, 31.086
    rgb, _, disparity_px = stereo_motorcycle()
    known = np.isfinite(disparity_px)
    depth_m = np.where(known, fx_px * baseline_m / (disparity_px + doffs_px), np.nan)
    intrinsics = CameraIntrinsics(fx_px, fx_px, 311.193, 254.877, rgb.shape[1], rgb.shape[0])
    return Photograph('stereo_motorcycle', np.ascontiguousarray(rgb), intrinsics,
                      'calibrated', depth_m.astype(np.float32))
