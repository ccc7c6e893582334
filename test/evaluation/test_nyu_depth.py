# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Frames from a file like nyu_depth_v2_labeled.mat, and its split."""


import numpy as np
import pytest
from nyu_files import nyu_room, write_nyu

from plane_detector.evaluation.nyu_depth import (
    COLUMNS,
    MAX_DEPTH_M,
    ROWS,
    NyuDepth,
    read_split,
)

h5py = pytest.importorskip('h5py', reason='the extra plane_detector[benchmark] is missing')
SEEDS = (9000, 9001)


@pytest.fixture(scope='module')
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp('nyu') / 'nyu_depth_v2_labeled.mat'
    write_nyu(path, SEEDS)
    return path


def test_a_frame_is_turned_and_cut(path):
    file = NyuDepth(path)
    assert len(file) == 2
    frame, scene = file.frame(2, 'filled'), nyu_room(SEEDS[1])
    np.testing.assert_array_equal(frame.rgb, scene.rgb[ROWS, COLUMNS])
    np.testing.assert_array_equal(frame.depth_m, scene.depth_m[ROWS, COLUMNS])
    assert frame.rgb.shape == (427, 561, 3), 'the size that the toolbox gives'
    assert (frame.rgb.dtype, frame.depth_m.dtype) == (np.uint8, np.float32)
    assert (frame.intrinsics.width, frame.intrinsics.height) == (561, 427)


def test_clamped_depth_is_unknown(tmp_path):
    path = tmp_path / 'far.mat'
    write_nyu(path, SEEDS[:1])
    with h5py.File(path, 'r+') as file:
        file['depths'][0, 100:200, 100:200] = MAX_DEPTH_M
    assert np.isnan(NyuDepth(path).frame(1, 'filled').depth_m[100 - ROWS.start,
                                                              100 - COLUMNS.start])


def test_instances_of_all_categories_are_told_apart(path):
    segments, true = (NyuDepth(path).frame(1).segments, nyu_room(SEEDS[0]).labels[ROWS, COLUMNS])
    pairs = np.unique(np.stack([segments.ravel(), true.ravel()]), axis=1)
    assert len(np.unique(pairs[0])) == len(np.unique(pairs[1])) == pairs.shape[1]
    assert segments.min() == (0 if true.min() < 0 else 1)


def test_errors_of_a_file_are_explained(path, tmp_path):
    with pytest.raises(FileNotFoundError, match='nyu_depth_v2_labeled'):
        NyuDepth(tmp_path / 'nothing.mat')
    (tmp_path / 'text.mat').write_text('no HDF5')
    with pytest.raises(ValueError, match='not a MATLAB 7.3'):
        NyuDepth(tmp_path / 'text.mat')
    with h5py.File(tmp_path / 'other.mat', 'w') as file:
        file['images'] = np.zeros((1, 3, 2, 2), np.uint8)
    with pytest.raises(ValueError, match='rawDepths, depths'):
        NyuDepth(tmp_path / 'other.mat')
    file = NyuDepth(path)
    for number in (0, 3):
        with pytest.raises(ValueError, match=f'no frame {number}; there are 1 to 2'):
            file.frame(number)
    with pytest.raises(ValueError, match='raw, filled'):
        file.frame(1, 'other')


def test_splits_of_matlab_and_of_text(tmp_path):
    from scipy.io import savemat
    matlab, text = tmp_path / 'splits.mat', tmp_path / 'frames.txt'
    savemat(matlab, {'testNdxs': np.array([[1], [2], [9]], np.uint16), 'trainNdxs': [[3], [4]]})
    text.write_text('1, 2\n9\n')
    assert read_split(matlab) == read_split(text) == (1, 2, 9)
