# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""A file like nyu_depth_v2_labeled.mat, made of rendered rooms."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from plane_detector.evaluation.benchmark.nyu import COLUMNS, INTRINSICS, ROWS
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rooms import Scene, random_room

HEADER = b'MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Wed May 16 18:59:13 2012 HDF5 '
KINECT_NOISE = 0.0015
TYPES = {'images': np.uint8, 'depths': np.float32, 'rawDepths': np.float32, 'labels': np.uint16,
         'instances': np.uint8}


def nyu_room(seed: int) -> Scene:
    """Return a room seen by the camera of the data."""
    return random_room(np.random.default_rng(seed), INTRINSICS)


def write_nyu(path: Path, seeds: Sequence[int]) -> None:
    """
    Write rooms with the names, the axes and the types of the real file.

    Every true plane is an annotated instance: category 1 + k modulo 3, instance 1 + k // 3.
    ``depths`` is exact; ``rawDepths`` has noise and a hole of 40 x 40 pixels.
    """
    import h5py
    images = [_images(nyu_room(seed), seed) for seed in seeds]
    with h5py.File(path, 'w', userblock_size=512) as file:
        for name, dtype in TYPES.items():
            file[name] = np.array([one[name].T for one in images]).astype(dtype)
    with path.open('r+b') as file:
        file.write(HEADER.ljust(124) + b'\x00\x02IM')


def _images(scene: Scene, seed: int) -> dict[str, np.ndarray]:
    raw_m = with_disparity_noise(scene.depth_m, KINECT_NOISE, np.random.default_rng(seed)).copy()
    raw_m[100:140, 100:140] = 0
    rgb = np.full_like(scene.rgb, 255)
    rgb[ROWS, COLUMNS] = scene.rgb[ROWS, COLUMNS]
    plane = scene.labels
    return {'images': rgb, 'depths': np.nan_to_num(scene.depth_m), 'rawDepths': raw_m,
            'labels': np.where(plane < 0, 0, 1 + plane % 3),
            'instances': np.where(plane < 0, 0, 1 + plane // 3)}
