# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""NYU Depth V2, on a file made of rendered rooms: its frames, its split, and the program."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import needs_onnxruntime  # noqa: F401
import numpy as np
import pytest

from plane_detector.depth.observation import DepthFunction
from plane_detector.evaluation.benchmark import nyu
from plane_detector.evaluation.benchmark.__main__ import main
from plane_detector.evaluation.benchmark.nyu import (
    COLUMNS,
    INTRINSICS,
    MAX_DEPTH_M,
    ROWS,
    NyuDepth,
)
from plane_detector.evaluation.peers import OpenCv
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rooms import Scene, random_room

h5py = pytest.importorskip('h5py', reason='the extra plane_detector[benchmark] is missing')
SEEDS = (9000, 9001)


@pytest.fixture(scope='module')
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp('nyu') / 'nyu_depth_v2_labeled.mat'
    write_nyu(path, SEEDS)
    with h5py.File(path, 'r+') as file:
        file['depths'][1, 100:200, 100:200] = MAX_DEPTH_M
    return path


def test_a_frame_is_turned_and_cut(path):
    file, scene = NyuDepth(path), nyu_room(SEEDS[1])
    assert len(file) == 2
    frame = file.frame(2, 'filled')
    np.testing.assert_array_equal(frame.rgb, scene.rgb[ROWS, COLUMNS])
    clamped = np.zeros(scene.depth_m.shape, bool)
    clamped[100:200, 100:200] = True
    np.testing.assert_array_equal(frame.depth_m, np.where(clamped, np.nan, scene.depth_m)[
        ROWS, COLUMNS].astype(np.float32))
    assert frame.rgb.shape == (427, 561, 3), 'the size that the toolbox gives'
    assert (frame.rgb.dtype, frame.depth_m.dtype) == (np.uint8, np.float32)
    assert (frame.intrinsics.width, frame.intrinsics.height) == (561, 427)
    true = scene.labels[ROWS, COLUMNS]
    pairs = np.unique(np.stack([frame.segments.ravel(), true.ravel()]), axis=1)
    assert len(np.unique(pairs[0])) == len(np.unique(pairs[1])) == pairs.shape[1]
    assert frame.segments.min() == (0 if true.min() < 0 else 1)


def test_errors_of_a_file_are_explained(path, tmp_path):
    with pytest.raises(FileNotFoundError, match='nyu_depth_v2_labeled'):
        NyuDepth(tmp_path / 'nothing.mat')
    (tmp_path / 'text.mat').write_text('no HDF5')
    with pytest.raises(ValueError, match='not a MATLAB 7.3'):
        NyuDepth(tmp_path / 'text.mat')
    with h5py.File(tmp_path / 'other.mat', 'w') as file:
        file['images'] = np.zeros((1, 3, 2, 2), np.uint8)
    with pytest.raises(ValueError, match='rawDepths, depths, labels, instances'):
        NyuDepth(tmp_path / 'other.mat')
    for number in (0, 3):
        with pytest.raises(ValueError, match=f'no frame {number}; there are 1 to 2'):
            NyuDepth(path).frame(number)


def test_splits_of_matlab_and_of_text(tmp_path):
    from scipy.io import savemat
    matlab, text = tmp_path / 'splits.mat', tmp_path / 'frames.txt'
    savemat(matlab, {'testNdxs': np.array([[1], [2], [9]], np.uint16), 'trainNdxs': [[3], [4]]})
    text.write_text('1, 2\n9\n')
    assert nyu.read_split(matlab) == nyu.read_split(text) == (1, 2, 9)


def rows(printed, name):
    return [[cell.strip() for cell in line.strip('| ').split(' | ')[1:]]
            for line in printed.splitlines() if line.startswith(f'| {name} |')]


@pytest.mark.skipif(bool(OpenCv(0.03).absent), reason=OpenCv(0.03).absent)
def test_every_method_is_scored_on_the_depth_of_sensor_and_network(path, tmp_path, monkeypatch,
                                                                   capsys):
    depth_m = nyu_room(SEEDS[0]).depth_m[ROWS, COLUMNS]
    network = DepthFunction(lambda rgb: (3 / depth_m + 0.5).astype(np.float32),
                            'relative_disparity', noise_share=0.001)
    monkeypatch.setattr(nyu, 'DepthEstimator', lambda config: network)
    (tmp_path / 'frames.txt').write_text('1')
    for options in (['--model', 'none'],
                    ['--model', 'made_up', '--split', str(tmp_path / 'frames.txt')]):
        main(['nyu', str(path), '--methods', 'ours', 'opencv', '--processes', '1', *options])
    nyu._detector.cache_clear()
    of_sensor, of_both = capsys.readouterr().out.split('### NYU Depth V2, ')[1:]
    assert of_sensor.startswith('2 frames, raw depth')
    (frames, worst, covering, *_, cpu_ms), recalls = rows(of_sensor, 'plane_detector, sensor')
    assert frames == '2' and len(recalls) == 8
    assert float(worst.split()[0]) <= float(covering)
    assert float(covering) > 0.95 and float(cpu_ms) > 0
    assert float(recalls[0].split(' / ')[1]) > 90
    assert len(rows(of_sensor, 'OpenCV findPlanes, 3 cm, sensor')) == 2
    assert float(rows(of_both, 'plane_detector, network')[0][2]) > 0.9
    assert float(rows(of_both, 'OpenCV findPlanes, 3 cm, network')[0][2]) > 0.5


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
