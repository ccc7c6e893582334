# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Test packs of ZeroPlane, from files of the same structure as the published ones."""

import re

import numpy as np
import pytest

from plane_detector.evaluation.benchmark.__main__ import main
from plane_detector.evaluation.datasets import zeroplane_frames
from plane_detector.evaluation.metrics import covering_of_truth, found_within
from plane_detector.evaluation.scenes.rooms import box, camera_rotation, render
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(518.86 * 0.4, 519.47 * 0.4, 325.58 * 0.4, 253.74 * 0.4, 256, 192)
SIZE_M = np.array([4.0, 5.0, 2.5])


@pytest.fixture
def pack(tmp_path):
    """Return a folder with one file: a room, a patch of it without a plane and without depth."""
    scene = render(box(SIZE_M / 2, SIZE_M), camera_rotation(5, -15, 0), np.array([2.0, 0.5, 1.4]),
                   CAMERA, np.random.default_rng(0))
    segments = scene.labels.astype(np.uint8)
    measured_m = scene.depth_m.astype(np.float32)
    segments[:20, :30], measured_m[:20, :30] = 20, 0.0
    folder = tmp_path / 'nyuv2_plane'
    folder.mkdir()
    planes = scene.planes[:, :3] / scene.planes[:, 3:]
    np.savez(folder / '0.npz', image=np.full((192, 256, 3), (10, 20, 30), np.uint8),
             raw_depth=measured_m, segmentation=segments, plane=planes.astype(np.float32),
             depth=np.where(segments == 20, 0, scene.depth_m)[None])
    return folder


def test_a_file_is_read_in_metres_rgb_and_with_its_camera(pack):
    frame, = zeroplane_frames(pack)
    assert frame.intrinsics == CAMERA
    assert (frame.set_name, frame.name) == ('nyuv2_plane', '0')
    assert frame.rgb[0, 0].tolist() == [30, 20, 10]
    for patch in (frame.depth_m, frame.plane_depth_m):
        assert np.isnan(patch[:20, :30]).all() and np.isfinite(patch[20:]).all()
    assert (frame.labels[:20, :30] == -1).all()
    assert frame.labels.max() + 1 == len(np.unique(frame.labels[20:]))


def test_a_camera_in_the_file_is_used(pack):
    with np.load(pack / '0.npz') as file:
        np.savez(pack / '0.npz', K=np.array([[200.0, 0, 128], [0, 210, 96], [0, 0, 1]]), **file)
    assert zeroplane_frames(pack)[0].intrinsics == CameraIntrinsics(200, 210, 128, 96, 256, 192)


def test_the_command_prints_both_conventions_and_the_limits(pack, capsys):
    main(['labelled', '--zeroplane', str(pack), '--only-ours'])
    printed = capsys.readouterr().out
    assert ('| set | method | n | SC | SC of truth | precision 1 mm | precision 5 mm | '
            'precision 10 mm | recall 1 mm | recall 5 mm | recall 10 mm |') in printed
    row = re.search(r'^\| nyuv2_plane \| plane_detector \| 1 \| (.*) \|$', printed, re.M)[1]
    covering, of_truth, *shares = map(float, row.split(' | '))
    assert covering > 0.97 and of_truth > 0.95
    assert shares == [1.0] * 6


def test_wrong_files_are_named(pack, tmp_path, capsys):
    with pytest.raises(SystemExit, match=r'no \.npz files in .*other'):
        main(['labelled', '--zeroplane', str(tmp_path / 'other')])
    np.savez(pack / '1.npz', image=np.zeros((2, 2, 3), np.uint8))
    with pytest.raises(ValueError, match=r'1\.npz has no depth, raw_depth, segmentation, only'):
        zeroplane_frames(pack)


def test_planes_are_found_within_limits_by_hand():
    """Two true planes in halves: one found 4 mm off, one split in two thirds and a third."""
    truth = np.repeat([[0, 1]], 12, axis=1).reshape(1, -1).repeat(10, axis=0)
    labels = truth.copy()
    labels[:, 20:] = 2
    depth_m = np.where(truth == 0, 2.0, 3.0)
    found_m = depth_m + np.where(labels == 0, 0.004, 0.009)
    everything = np.ones(truth.shape, bool)
    precision, recall = found_within(truth, depth_m, labels, found_m, everything,
                                     (0.001, 0.005, 0.01))
    assert precision == pytest.approx([0, 1 / 3, 2 / 3])
    assert recall == pytest.approx([0, 1 / 2, 1])


def test_precision_is_unknown_without_planes():
    truth = np.zeros((4, 4), int)
    precision, recall = found_within(truth, np.ones((4, 4)), truth - 1, np.ones((4, 4)),
                                     np.ones((4, 4), bool), (0.001,))
    assert np.isnan(precision).all()
    assert recall == [0]


def test_covering_of_the_truth_is_one_sided():
    assert covering_of_truth(np.array([[6, 2], [0, 2]])) == pytest.approx(
        (8 * 6 / 8 + 2 * 2 / 4) / 10)
