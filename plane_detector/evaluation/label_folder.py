# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Results of any method as files: a label image for each frame, optionally with its planes.

A label image is a PNG of 8 or 16 bits: 0 for no plane, any other value for a plane. The last
number in its name is that of the frame. Tables of planes are CSV files in the same folder with the
columns COLUMNS: a plane is normal . p + d = 0 in metres, p in the optical frame (x right, y down,
z forward), and ``label`` is the value in the image.

The published plane annotation of NYU Depth V2 (NYUv2-Plane, by the authors of PlaneAE) is
supported too: ``plane_instance_<frame>.npz`` with ``plane_instance`` (192, 256), 0 for no plane,
which shows the frame without its border.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

COLUMNS = ('frame', 'label', 'normal_x', 'normal_y', 'normal_z', 'd')

PlaneTable = Mapping[tuple[int, int], np.ndarray]
"""Unit normal and offset (4,) by frame and label."""


def label_files(folder: Path) -> dict[int, Path]:
    """
    Return the label images of a folder by frame number.

    Raises
    ------
    FileNotFoundError
        The folder does not exist, or contains no PNG file.
    ValueError
        A name has no number, or two have the same.

    """
    # The published annotation also has PNG files, which show it in colours.
    paths = sorted(folder.glob('*.npz')) or sorted(folder.glob('*.png'))
    if not paths:
        raise FileNotFoundError(f'there is no folder {folder} with label images (PNG, or NPZ of '
                                'NYUv2-Plane)')
    found: dict[int, Path] = {}
    for path in paths:
        numbers = re.findall(r'\d+', path.stem)
        if not numbers:
            raise ValueError(f'the name of {path} has no frame number')
        if int(numbers[-1]) in found:
            raise ValueError(f'{path} and {found[int(numbers[-1])]} have the same frame number')
        found[int(numbers[-1])] = path
    return found


def read_labels(path: Path, shape: tuple[int, int]) -> np.ndarray:
    """
    Read a label image.

    Parameters
    ----------
    path : Path
    shape : (int, int)
        Required height and width. An image of another size but the same aspect ratio is resized
        with nearest labels.

    Returns
    -------
    (H, W) int32
        Values as in the file.

    Raises
    ------
    ValueError
        It cannot be read, has several channels, or another aspect ratio.

    """
    values = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if values is None or values.ndim != 2 or values.dtype not in (np.uint8, np.uint16):
        raise ValueError(f'{path} must be a PNG of one channel with 8 or 16 bits')
    height, width = shape
    # Allows for rounding by half a pixel of the smaller image.
    if abs(values.shape[1] * height - values.shape[0] * width) > max(height, width) / 2:
        raise ValueError(f'{path} is {values.shape[1]} x {values.shape[0]}; it must have the '
                         f'shape of {width} x {height}')
    return cv2.resize(values, (width, height), interpolation=cv2.INTER_NEAREST).astype(np.int32)


def read_annotation(path: Path, shape: tuple[int, int]) -> np.ndarray:
    """
    Read a file of NYUv2-Plane, stretched to the required height and width.

    Raises
    ------
    ValueError
        It is not such a file.

    """
    try:
        with np.load(path) as content:
            values = content['plane_instance'].astype(np.int32)
    except (OSError, KeyError, ValueError) as error:
        raise ValueError(f'{path} is not a file of NYUv2-Plane: {error}') from error
    return cv2.resize(np.squeeze(values), shape[::-1], interpolation=cv2.INTER_NEAREST)


def read_plane_table(folder: Path) -> dict[tuple[int, int], np.ndarray]:
    """
    Read all tables of planes in a folder; the result may be empty.

    Raises
    ------
    ValueError
        A column is missing, a value is not a number, or a normal is zero.

    """
    planes: dict[tuple[int, int], np.ndarray] = {}
    for path in sorted(folder.glob('*.csv')):
        with path.open(newline='', encoding='utf-8') as file:
            for row in csv.DictReader(file):
                try:
                    plane = np.array([float(row[name]) for name in COLUMNS[2:]])
                    key = int(row['frame']), int(row['label'])
                except (KeyError, TypeError, ValueError) as error:
                    raise ValueError(f'{path}: every line must have numbers in the columns '
                                     f'{", ".join(COLUMNS)} ({error})') from error
                length = np.linalg.norm(plane[:3])
                if not (np.isfinite(plane).all() and length > 0):
                    raise ValueError(f'{path}: the plane of frame {key[0]}, label {key[1]} is '
                                     'zero')
                planes[key] = plane / length * (-1 if plane[3] < 0 else 1)
    return planes


def planes_of_frame(table: PlaneTable, frame: int, values: np.ndarray) -> np.ndarray:
    """
    Return the planes of the labels ``values`` (K,) of a frame, (K, 4).

    Raises
    ------
    ValueError
        The table lacks a plane.

    """
    missing = [int(value) for value in values if (frame, int(value)) not in table]
    if missing:
        raise ValueError(f'frame {frame}: the CSV has no plane for the labels {missing}')
    return np.array([table[frame, int(value)] for value in values]).reshape(-1, 4)


def write_labels(folder: Path, frame: int, labels: np.ndarray, planes: np.ndarray) -> None:
    """
    Write a label image and its planes.

    Parameters
    ----------
    folder : Path
        Created if it does not exist.
    frame : int
    labels : (H, W) int
        Index into ``planes``, or -1.
    planes : (K, 4) float
        Unit normal and offset in metres.

    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f'{frame:05}.png'
    if not cv2.imwrite(str(path), (labels + 1).astype(np.uint16)):
        raise OSError(f'{path} cannot be written')
    with path.with_suffix('.csv').open('w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for k, plane in enumerate(planes.tolist()):
            writer.writerow([frame, k + 1, *map(repr, plane)])
