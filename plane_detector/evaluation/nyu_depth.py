# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Reader for the labelled part of NYU Depth V2, ``nyu_depth_v2_labeled.mat``, frame by frame.

The file is MATLAB 7.3, which is HDF5 with reversed axes: H x W x 3 x N is N x 3 x W x H. Frames
are counted from 1, as in the split file. Needs h5py.

References
----------
N. Silberman, D. Hoiem, P. Kohli, R. Fergus: Indoor Segmentation and Support Inference from RGBD
Images, ECCV 2012; calibration and border are from the toolbox of the data set.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from plane_detector.types import CameraIntrinsics

# The toolbox counts pixels from 1, CameraIntrinsics from 0.
INTRINSICS = CameraIntrinsics(518.85790117450188, 519.46961112127485, 325.58244941119034 - 1,
                              253.73616633400465 - 1, 640, 480)
# Rows and columns that both cameras see; outside of them the images are white.
ROWS, COLUMNS = slice(44, 471), slice(40, 601)
# The toolbox limits larger depths to this.
MAX_DEPTH_M = 10.0
DEPTHS = {'raw': 'rawDepths', 'filled': 'depths'}


@dataclass(frozen=True)
class NyuFrame:
    """A frame without its border."""

    number: int  # from 1
    rgb: np.ndarray  # (H, W, 3) uint8
    depth_m: np.ndarray  # (H, W) float32: naN where not measured
    # (H, W) int32: index of each annotated instance, 0 for pixels without annotation
    segments: np.ndarray
    intrinsics: CameraIntrinsics


class NyuDepth:
    """The opened file; an error says what is missing."""

    def __init__(self, path: Path) -> None:
        try:
            import h5py
        except ImportError as error:
            raise ImportError('reading MATLAB 7.3 files needs h5py: pip install h5py, or the '
                              'extra plane_detector[benchmark]') from error
        if not path.is_file():
            raise FileNotFoundError(f'there is no file {path}; nyu_depth_v2_labeled.mat is on the '
                                    'page of NYU Depth V2')
        try:
            self._file = h5py.File(path, 'r')
        except OSError as error:
            raise ValueError(f'{path} is not a MATLAB 7.3 (HDF5) file: {error}') from error
        missing = [name for name in ('images', *DEPTHS.values()) if name not in self._file]
        if missing:
            raise ValueError(f'{path} has no data set {", ".join(missing)}')
        self.has_annotations = all(name in self._file for name in ('labels', 'instances'))

    def __len__(self) -> int:
        return self._file['images'].shape[0]

    def frame(self, number: int, depth: str = 'raw') -> NyuFrame:
        """Read a frame, counted from 1, with ``raw`` depth of the sensor or ``filled`` depth."""
        if not 1 <= number <= len(self):
            raise ValueError(f'there is no frame {number}; there are 1 to {len(self)}')
        if depth not in DEPTHS:
            raise ValueError(f'depth must be one of {", ".join(DEPTHS)}, not {depth}')
        depth_m = self._read(DEPTHS[depth], number).astype(np.float32)
        depth_m[~((depth_m > 0) & (depth_m < MAX_DEPTH_M))] = np.nan
        segments = np.zeros(depth_m.shape, np.int32)
        if self.has_annotations:
            category, instance = (self._read(name, number).astype(np.int64)
                                  for name in ('labels', 'instances'))
            known = category > 0
            segments[known] = 1 + np.unique((category * 1000 + instance)[known],
                                            return_inverse=True)[1]
        return NyuFrame(number, self._read('images', number), depth_m, segments,
                        replace(INTRINSICS, cx=INTRINSICS.cx - COLUMNS.start,
                                cy=INTRINSICS.cy - ROWS.start, width=COLUMNS.stop - COLUMNS.start,
                                height=ROWS.stop - ROWS.start))

    def _read(self, name: str, number: int) -> np.ndarray:
        """Return an image without its border: (H, W) or (H, W, 3)."""
        return np.ascontiguousarray(self._file[name][number - 1].T[ROWS, COLUMNS])


def read_split(path: Path) -> tuple[int, ...]:
    """Return the numbers, from 1, of the test frames of splits.mat, or those in a text file."""
    from scipy.io import loadmat
    if not path.is_file():
        raise FileNotFoundError(f'there is no file {path}')
    try:
        if path.suffix == '.mat':
            numbers = np.ravel(loadmat(path)['testNdxs']).astype(int)
        else:
            numbers = np.array(path.read_text().replace(',', ' ').split(), int)
    except (KeyError, ValueError, NotImplementedError) as error:
        raise ValueError(f'{path} is not a list of frame numbers: {error}') from error
    if not numbers.size:
        raise ValueError(f'{path} is empty')
    return tuple(numbers.tolist())
