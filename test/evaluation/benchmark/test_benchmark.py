# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The benchmark judges right, names what is absent, and prints its tables."""

import json

import cv2
import numpy as np
import pytest

from plane_detector import CameraIntrinsics
from plane_detector.evaluation import peers
from plane_detector.evaluation.benchmark import runtime as benchmark_times
from plane_detector.evaluation.benchmark import tables as benchmark_report
from plane_detector.evaluation.benchmark.judging import judge_coverage
from plane_detector.evaluation.benchmark.living_rooms import furnished, report_living
from plane_detector.evaluation.benchmark.parallel import one_thread
from plane_detector.evaluation.benchmark.real_images import (
    compare,
    report_consistency,
    write_sheets,
)
from plane_detector.evaluation.benchmark.rooms import (
    HELD_OUT,
    report_rooms,
    room,
    room_score,
)
from plane_detector.evaluation.datasets import frames, library_frames
from plane_detector.evaluation.metrics import score
from plane_detector.evaluation.plane_geometry import plane_depth
from plane_detector.evaluation.scenes.rooms import random_room, single_wall

SMALL = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)
WALL = single_wall(SMALL, yaw_deg=0, distance_m=2.0)


def test_coverage_by_hand():
    """Two large planes of the sensor: one found in two pieces of 3 to 1, one not at all."""
    sensor, found = np.full((2, 10, 20), -1)
    sensor[:4], sensor[4:8], sensor[9, :2] = 0, 1, 2
    found[:3], found[3:4] = 0, 1
    seen = np.ones(sensor.shape, bool)
    coverage = judge_coverage(sensor, found, seen)
    assert coverage.planes == 2, 'the third has no more than 2 % of the picture'
    assert coverage.share == pytest.approx(60 / 160)
    assert coverage.pieces == pytest.approx((2 + 0) / 2)


def test_without_large_planes_coverage_is_unknown():
    nothing = np.full((10, 20), -1)
    coverage = judge_coverage(nothing, nothing, nothing < 0)
    assert coverage.planes == 0
    assert np.isnan(coverage.share)


def test_the_depth_of_a_plane_is_where_the_rays_meet_it():
    scene = random_room(np.random.default_rng(2), SMALL)
    np.testing.assert_allclose(plane_depth(scene.labels, scene.planes, SMALL), scene.depth_m,
                               rtol=1e-4)
    nothing = np.full((120, 160), -1)
    assert np.isnan(plane_depth(nothing, scene.planes[:0], SMALL)).all()


@pytest.mark.parametrize('method', peers.all_methods(), ids=lambda method: method.name)
def test_every_method_finds_a_wall_or_says_why_it_cannot(method):
    if method.absent:
        pytest.skip(method.absent)
    wall = single_wall(SMALL, yaw_deg=20, distance_m=2.0)
    labels, planes = method(wall.depth_m, SMALL)
    result = score(wall.labels, wall.planes, labels, planes, np.isfinite(wall.depth_m))
    assert labels.shape == (120, 160)
    assert labels.max() == len(planes) - 1
    assert result.recall == 1
    assert result.normal_error_deg < 1
    assert result.offset_error_m < 0.02
    assert (planes[:, 3] >= 0).all()


def test_what_cannot_be_imported_is_said_to_be_missing():
    assert 'no_such_module_here' in peers._missing('no_such_module_here')
    assert peers._missing('numpy') == ''


@pytest.mark.parametrize('side', [1, 3])
def test_a_mosaic_has_its_planes(side):
    scene = benchmark_times.mosaic(side)
    assert len(scene.planes) == side**2
    assert np.bincount(scene.labels[scene.labels >= 0]).min() > 0.5 * scene.labels.size / side**2


def test_times_are_taken_of_every_method_and_case():
    case = (WALL.depth_m, SMALL)
    ms = benchmark_times.median_ms([peers.Ours()], [case, case], repeats=2)
    assert ms.shape == (1, 2)
    assert (ms > 0).all()


def test_one_thread_is_put_back():
    before = cv2.getNumThreads()
    with one_thread():
        assert cv2.getNumThreads() == 1
    assert cv2.getNumThreads() == before


def test_tables_are_markdown():
    assert benchmark_report.table(('a', 'b'), [(1, 'x')]) == '| a | b |\n| --- | --- |\n| 1 | x |'


def test_rooms_are_reported_with_the_absent_named(capsys):
    absent = peers.Ours()
    absent.name, absent.absent = 'nowhere', 'nothing of that name is installed'
    report_rooms([peers.Ours(), absent], count=1, slow_count=1)
    text = capsys.readouterr().out
    assert 'nowhere: absent, nothing of that name is installed.' in text
    assert text.count('| plane_detector | 0 | 1 |') == 2, 'tuning and held-out'
    assert 'share that match' in text


def test_living_rooms_are_reported_and_drawn(capsys, tmp_path):
    report_living([peers.Ours()], count=1, slow_count=1, output=tmp_path / 'sheets')
    text = capsys.readouterr().out
    assert '### Rendered living rooms, tuning seeds 0 to 0' in text
    assert f'### Rendered living rooms, held-out seeds {HELD_OUT} to {HELD_OUT}' in text
    assert text.count('| plane_detector | 0.004 | 1 |') == 2
    sheet = cv2.imread(str(tmp_path / 'sheets' / 'living_rooms.png'))
    assert sheet.shape[1] > 6 * 320
    assert sheet.shape[0] < 2 * 320, 'one row for one room'


class Truth(peers.Method):
    """Knows the labels, and calls what is curved a plane if asked to."""

    def __init__(self, scene, curved=False):
        self.scene, self.curved = scene, curved

    def __call__(self, depth_m, intrinsics):
        labels = self.scene.labels.copy()
        if self.curved:
            labels[labels < 0] = len(self.scene.planes)
        return labels, np.vstack([self.scene.planes, [0, 0, -1, 2]])[:labels.max() + 1]


@pytest.mark.parametrize('scene_of', [room, furnished])
def test_the_truth_scores_full_marks(scene_of):
    scene = scene_of(0)
    best = room_score(Truth(scene), 0, 0.0, scene_of)
    assert best.segmentation_covering == best.rand_index == best.recall == best.precision == 1
    assert best.normal_error_deg == pytest.approx(0, abs=1e-4)


def test_curved_pixels_count_as_no_plane():
    scene = furnished(0)
    planes = len(scene.planes)
    called_flat = room_score(Truth(scene, curved=True), 0, 0.0, furnished)
    assert called_flat.precision == pytest.approx(planes / (planes + 1))


def write_frame(folder, depth_mm):
    folder.mkdir()
    about = {'fx': 131.0, 'fy': 131.0, 'cx': 79.5, 'cy': 59.5, 'width': 160, 'height': 120,
             'depth_unit_m': 0.001, 'invalid': 0}
    (folder / 'intrinsics.json').write_text(json.dumps(about))
    cv2.imwrite(str(folder / '7_depth.png'), depth_mm)
    cv2.imwrite(str(folder / '7_rgb.png'), np.full((120, 160, 3), (10, 20, 30), np.uint8))


def test_frames_are_read_in_metres_and_rgb(tmp_path):
    depth_mm = np.full((120, 160), 2500, np.uint16)
    depth_mm[0] = 0
    write_frame(tmp_path / 'living_room', depth_mm)
    (frame,) = frames(tmp_path)
    assert (frame.set_name, frame.name) == ('living_room', '7')
    assert frame.depth_m[1, 0] == pytest.approx(2.5)
    assert np.isnan(frame.depth_m[0]).all()
    np.testing.assert_array_equal(frame.rgb[0, 0], [30, 20, 10])


def test_frames_that_are_missing_or_of_another_size_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match='nowhere'):
        list(frames(tmp_path / 'nowhere'))
    write_frame(tmp_path / 'set', np.ones((60, 80), np.uint16))
    with pytest.raises(FileNotFoundError, match='no set other, only set'):
        list(frames(tmp_path, ('other',)))
    with pytest.raises(ValueError, match='160 x 120'):
        list(frames(tmp_path))


def test_a_frame_is_compared_with_the_network_and_drawn(tmp_path, capsys):
    write_frame(tmp_path / 'living_room', np.full((120, 160), 2000, np.uint16))
    (frame,) = frames(tmp_path)
    compared = [compare(frame, lambda rgb: WALL.depth_m), compare(frame, None)]
    assert compared[0].coverage.share == pytest.approx(1)
    assert compared[0].judged[0].purity == pytest.approx(1)
    assert compared[1].network is None
    (sheet,) = write_sheets(compared, tmp_path / 'sheets')
    assert cv2.imread(str(sheet)).shape[1] > 3 * 400
    report_consistency([frame])
    rows = [line.split(' | ') for line in capsys.readouterr().out.splitlines()]
    (covering,) = (float(row[2]) for row in rows if row[0] == '| 0.004')
    assert covering > 0.9


def test_library_frames_have_known_depth():
    pytest.importorskip('skimage', reason='scikit-image is not installed')
    (frame,) = library_frames()
    assert frame.rgb.shape[:2] == frame.depth_m.shape == (500, 741)
    assert 2 < np.nanmedian(frame.depth_m) < 4


def test_every_real_frame_has_planes_by_its_sensor(data_folder):
    names = []
    for frame in frames(data_folder, ('nyu', 'kinect')):
        found = compare(frame, None).sensor
        names.append(frame.name)
        assert 4 <= len(found.planes) <= 32
        seen = np.isfinite(frame.depth_m)
        assert (found.labels[seen] >= 0).mean() > 0.6
    assert len(names) == 8


def test_a_depth_camera_is_not_taken_for_a_network(data_folder):
    """A Kinect is good to an eighth of a pixel, 0.003 per metre, also in a cluttered room."""
    noise = {frame.name: compare(frame, None).sensor.disparity_noise
             for frame in frames(data_folder, ('nyu', 'kinect'))}
    assert max(noise.values()) < 0.005, noise
    assert min(noise.values()) > 0.0005, noise
