# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Real pictures with the depth that a sensor measured.

A data folder holds sets, one folder each: ``<id>_rgb.png`` or ``.jpg``, ``<id>_depth.png``
(uint16, registered to the picture, 0 invalid) and ``intrinsics.json`` with fx, fy, cx, cy, width,
height and depth_unit_m.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from plane_detector.tools.demo.photographs import library_pictures
from plane_detector.types import CameraIntrinsics

# Of long sequences every tenth frame is enough: neighbours look alike.
STEPS = {'living_room': 10}


@dataclass(frozen=True)
class Frame:
    """
    A picture with measured depth.

    Attributes
    ----------
    set_name, name : str
    rgb : (H, W, 3) uint8
    depth_m : (H, W) float32
        NaN where the sensor saw nothing.
    intrinsics : CameraIntrinsics

    """

    set_name: str
    name: str
    rgb: np.ndarray
    depth_m: np.ndarray
    intrinsics: CameraIntrinsics


def frames(data: Path, sets: tuple[str, ...] | None = None, first: int = 0) -> Iterator[Frame]:
    """
    Yield the frames of a data folder, set by set.

    Parameters
    ----------
    data : Path
    sets : tuple of str, optional
        Names of the sets, default all.
    first : int
        Of long sequences, of which only some frames are taken, start with this one.

    Raises
    ------
    FileNotFoundError
        The folder or a set is missing.
    ValueError
        A picture cannot be read, or is of another size than its calibration says.

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
    """Read the frame that a depth picture belongs to; raises as :func:`frames` does."""
    folder, name = depth_path.parent, depth_path.name.removesuffix('_depth.png')
    about = json.loads((folder / 'intrinsics.json').read_text())
    intrinsics = CameraIntrinsics(
        *(about[key] for key in ('fx', 'fy', 'cx', 'cy', 'width', 'height')))
    raw = cv2.imread(str(depth_path), cv2.IMREAD_UNCHANGED)
    pictures = sorted(folder.glob(f'{name}_rgb.*'))
    bgr = cv2.imread(str(pictures[0])) if pictures else None
    shape = (intrinsics.height, intrinsics.width)
    if raw is None or bgr is None or raw.shape != shape or bgr.shape[:2] != shape:
        raise ValueError(f'{depth_path} and its picture must be readable and {shape[1]} x '
                         f'{shape[0]}')
    depth_m = raw.astype(np.float32) * np.float32(about['depth_unit_m'])
    depth_m[raw == about.get('invalid', 0)] = np.nan
    return Frame(folder.name, name, np.ascontiguousarray(bgr[..., ::-1]), depth_m, intrinsics)


def library_frames() -> list[Frame]:
    """
    Return the pictures of known depth that come inside libraries.

    Raises
    ------
    ImportError
        scikit-image, or Pillow that reads its pictures, is not installed.

    """
    return [Frame('libraries', picture.name, picture.rgb, picture.true_depth_m,
                  picture.intrinsics)
            for picture in library_pictures() if picture.true_depth_m is not None]
