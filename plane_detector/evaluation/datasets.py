# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Real images with the measured depth of a sensor.

A data folder contains one folder per set, with ``<id>_rgb.png`` or ``.jpg``, ``<id>_depth.png``
(uint16, registered to the image, 0 invalid) and ``intrinsics.json`` with fx, fy, cx, cy, width,
height and depth_unit_m.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from plane_detector.tools.demo.photographs import library_images
from plane_detector.types import CameraIntrinsics

# Every tenth frame of long sequences, because neighbouring frames are similar.
STEPS = {'living_room': 10}


@dataclass(frozen=True)
class Frame:
    """
    An image with measured depth.

    Attributes
    ----------
    set_name, name : str
    rgb : (H, W, 3) uint8
    depth_m : (H, W) float32
        NaN where not measured.
    intrinsics : CameraIntrinsics

    """

    set_name: str
    name: str
    rgb: np.ndarray
    depth_m: np.ndarray
    intrinsics: CameraIntrinsics


def frames(data: Path, sets: tuple[str, ...] | None = None, first: int = 0) -> Iterator[Frame]:
    """
    Yield the frames of a data folder, one set after another.

    Parameters
    ----------
    data : Path
    sets : tuple of str, optional
        Names of the sets; default: all.
    first : int
        First frame of long sequences, of which only every STEPS-th frame is used.

    Raises
    ------
    FileNotFoundError
        The folder or a set is missing.
    ValueError
        An image cannot be read, or its size differs from its calibration.

    """
    if not data.is_dir():
        raise FileNotFoundError(f'there is no data folder {data}')
    found = sorted(path.parent.name for path in data.glob('*/intrinsics.json'))
    for name in sets or found:
        if name not in found:
            raise FileNotFoundError(f'{data} has no set {name}, only {", ".join(found)}')
        depths = sorted((data / name).glob('*_depth.png'))
        for path in depths[first::STEPS[name]] if name in STEPS else depths:
            yield read_frame(path)


def read_frame(depth_path: Path) -> Frame:
    """Read the frame of a depth image; raises as :func:`frames`."""
    folder, name = depth_path.parent, depth_path.name.removesuffix('_depth.png')
    about = json.loads((folder / 'intrinsics.json').read_text())
    intrinsics = CameraIntrinsics(
        *(about[key] for key in ('fx', 'fy', 'cx', 'cy', 'width', 'height')))
    raw = cv2.imread(str(depth_path), cv2.IMREAD_UNCHANGED)
    images = sorted(folder.glob(f'{name}_rgb.*'))
    bgr = cv2.imread(str(images[0])) if images else None
    shape = (intrinsics.height, intrinsics.width)
    if raw is None or bgr is None or raw.shape != shape or bgr.shape[:2] != shape:
        raise ValueError(f'{depth_path} and its image must be readable and {shape[1]} x '
                         f'{shape[0]}')
    depth_m = raw.astype(np.float32) * np.float32(about['depth_unit_m'])
    depth_m[raw == about.get('invalid', 0)] = np.nan
    return Frame(folder.name, name, np.ascontiguousarray(bgr[..., ::-1]), depth_m, intrinsics)


def library_frames() -> list[Frame]:
    """
    Return the images with known depth that are included in libraries.

    Raises
    ------
    ImportError
        scikit-image, or Pillow that reads its images, is not installed.

    """
    return [Frame('libraries', photograph.name, photograph.rgb, photograph.true_depth_m,
                  photograph.intrinsics)
            for photograph in library_images() if photograph.true_depth_m is not None]
