# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Real images with the measured depth of a sensor.

A data folder contains one folder per set, with ``<id>_rgb.png`` or ``.jpg``, ``<id>_depth.png``
(uint16, registered to the image, 0 invalid) and ``intrinsics.json`` with fx, fy, cx, cy, width,
height and depth_unit_m, or below ``frames`` those of each id. The sets below ``labelled`` and
``sensors`` and the set ``abw`` also have planes labelled by hand, ``<id>_labels.png``. Test packs
of ZeroPlane have a reader of their own.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from plane_detector.drawing import colour_depth
from plane_detector.types import CameraIntrinsics

# Every tenth frame of long sequences, because neighbouring frames are similar.
STEPS = {'living_room': 10}


@dataclass(frozen=True)
class Frame:
    """An image with measured depth."""

    set_name: str
    name: str
    rgb: np.ndarray  # (H, W, 3) uint8
    depth_m: np.ndarray  # (H, W) float32: naN where not measured
    intrinsics: CameraIntrinsics


def frames(data: Path, sets: tuple[str, ...] | None = None, first: int = 0) -> Iterator[Frame]:
    """
    Yield the frames of some sets, by default of all, one set after another.

    Of long sequences only every STEPS-th frame is used, from the first one on. Raises
    FileNotFoundError if the folder or a set is missing, and ValueError if an image cannot be read
    or its size differs from its calibration.
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
    about |= about.get('frames', {}).get(name, {})
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


NO_PLANE, UNKNOWN = -1, -2
TABLETOPS, OF_TODAY = 'osd_tabletop', 'sensors'
ABW = 'abw'
# Of the scanner of the set ABW (Hoover et al. 1996), as its range images are stored: depth in
# millimetres is _ABW_NEAREST_MM + range / _ABW_STEPS_PER_MM.
_ABW_CAMERA = CameraIntrinsics(1610.981722, 2337.212, 255.0, 255.0, 512, 512)
_ABW_NEAREST_MM, _ABW_STEPS_PER_MM = 785.410786, 0.773545
_ABW_FIRST_REGION = 10


@dataclass(frozen=True)
class LabelledFrame(Frame):
    """A frame with planes labelled by hand."""

    # (H, W) int32: plane of each pixel from 0, NO_PLANE where the labels say that there is
    # none, UNKNOWN where they say nothing
    labels: np.ndarray


def labelled_frames(data: Path) -> Iterator[LabelledFrame]:
    """
    Yield the frames of a data folder that were labelled by hand.

    Labels that ``intrinsics.json`` lists as not one plane are UNKNOWN. On table tops, labels 1 to
    9 are one plane, the table, and the objects on it are NO_PLANE. Raises as :func:`frames`.
    """
    paths = sorted(path for parent in ('labelled', OF_TODAY)
                   for path in data.glob(f'{parent}/*/*_labels.png'))
    if not paths:
        raise FileNotFoundError(f'{data} has no frames labelled by hand in the folders labelled '
                                f'and {OF_TODAY}')
    for path in paths:
        name, raw = path.name.removesuffix('_labels.png'), _read_image(path).astype(np.int32)
        frame = read_frame(path.with_name(f'{name}_depth.png'))
        if path.parts[-3] == OF_TODAY:
            frame = replace(frame, set_name=OF_TODAY)
        if frame.set_name == TABLETOPS:
            labels = np.select([raw == 0, raw < 10], [UNKNOWN, 0], NO_PLANE)
        else:
            about = json.loads((path.parent / 'intrinsics.json').read_text())
            left_out = about.get('frames', {}).get(name, {}).get('labels_not_one_plane', [])
            labels = numbered(raw, (raw > 0) & ~np.isin(raw, left_out), UNKNOWN)
        yield LabelledFrame(**vars(frame), labels=labels.astype(np.int32))
    for path in sorted((data / ABW).glob('*_labels.png')):
        name, raw = path.name.removesuffix('_labels.png'), _read_image(path)
        range_image = _read_image(path.with_name(f'{name}_range.png'))
        depth_m = ((_ABW_NEAREST_MM + range_image / _ABW_STEPS_PER_MM) / 1000).astype(np.float32)
        depth_m[range_image == 0] = np.nan
        yield LabelledFrame(ABW, name, colour_depth(depth_m), depth_m, _ABW_CAMERA,
                            numbered(raw, raw >= _ABW_FIRST_REGION, UNKNOWN))


def _read_image(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ValueError(f'{path} cannot be read')
    return image


def numbered(raw: np.ndarray, kept: np.ndarray, elsewhere: int = NO_PLANE) -> np.ndarray:
    """Return labels renumbered from 0 without gaps, (H, W) int32, and a label elsewhere."""
    labels = np.full(raw.shape, elsewhere, np.int32)
    labels[kept] = np.unique(raw[kept], return_inverse=True)[1]
    return labels


@dataclass(frozen=True)
class ZeroPlaneFrame(LabelledFrame):
    """A frame of a test pack of ZeroPlane, whose true planes have a depth."""

    plane_depth_m: np.ndarray  # (H, W) float32: of the true plane at each pixel, NaN elsewhere


_ZEROPLANE_NO_PLANE = 20
# Of NYU and of 7-Scenes alike at 640 x 480, as ZeroPlane's code has it; the files have none.
_ZEROPLANE_MATRIX = np.array([[518.86, 0, 325.58], [0, 519.47, 253.74], [0, 0, 1]])


def zeroplane_frames(folder: Path) -> list[ZeroPlaneFrame]:
    """
    Return the frames of a test pack of ZeroPlane: a folder of .npz files.

    Each file has ``image`` (H, W, 3) uint8 BGR, ``raw_depth`` (H, W) in metres, 0 where not
    measured, ``segmentation`` (H, W) with the index of each pixel's plane, 20 for none, and
    ``depth`` (1, H, W), the depth of that plane. ``K`` (3, 3) is used if it is there. Raises
    FileNotFoundError without such files and ValueError for one that has something else.

    References
    ----------
    J. Liu et al.: Towards In-the-wild 3D Plane Reconstruction from a Single Image, CVPR 2025;
    the files as its evaluation code reads them.

    """
    paths = sorted(folder.glob('*.npz'))
    if not paths:
        raise FileNotFoundError(f'there are no .npz files in {folder}')
    return [_zeroplane_frame(path) for path in paths]


def _zeroplane_frame(path: Path) -> ZeroPlaneFrame:
    with np.load(path) as file:
        wanted = {'image', 'raw_depth', 'segmentation', 'depth'}
        if not wanted <= set(file.files):
            raise ValueError(f'{path} has no {", ".join(sorted(wanted - set(file.files)))}, '
                             f'only {", ".join(file.files)}')
        image, measured_m, segments, plane_m = (
            file[name] for name in ('image', 'raw_depth', 'segmentation', 'depth'))
        matrix = file['K'] if 'K' in file.files else None
    plane_m = plane_m.reshape(plane_m.shape[-2:])
    height, width = segments.shape
    if not image.shape[:2] == measured_m.shape == plane_m.shape == segments.shape:
        raise ValueError(f'{path}: image, depths and segmentation must have one size')
    if matrix is None:
        matrix = np.diag([width / 640, height / 480, 1]) @ _ZEROPLANE_MATRIX
    places = (0, 0), (1, 1), (0, 2), (1, 2)
    camera = CameraIntrinsics(*(float(matrix[place]) for place in places),
                              width, height)
    is_plane = segments != _ZEROPLANE_NO_PLANE
    return ZeroPlaneFrame(
        path.parent.name, path.stem, np.ascontiguousarray(image[..., ::-1]),
        np.where(measured_m > 0, measured_m, np.nan).astype(np.float32), camera,
        numbered(segments, is_plane), np.where(is_plane, plane_m, np.nan).astype(np.float32))
