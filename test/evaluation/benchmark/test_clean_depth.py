# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Clean depth is evaluated with the labels grown from it, with and without unclear pixels."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from plane_detector import CameraIntrinsics
from plane_detector.evaluation import peers
from plane_detector.evaluation.benchmark.clean_depth import (
    LabelledFrame,
    frame_scores,
    held_out_frames,
    leave_out,
    report_exact,
    segmented,
)
from plane_detector.evaluation.benchmark.rooms import SIGMAS
from plane_detector.evaluation.datasets import Frame, frames
from plane_detector.evaluation.reference_labels import ExactLabels
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rooms import single_wall

SMALL = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)
WALL = single_wall(SMALL, yaw_deg=20, distance_m=2.0)
FRAME = Frame('living_room', '00007', WALL.rgb, WALL.depth_m, SMALL)


class Fixed(peers.Method):
    """Gives the same labels for any image, and keeps the depth that it was given."""

    def __init__(self, labels, planes):
        self.labels, self.planes, self.depth_m = labels, planes, None

    def __call__(self, depth_m, intrinsics):
        self.depth_m = depth_m
        return self.labels, self.planes


def halves():
    """Return the wall on the left, nothing on the right, and where that is unclear."""
    labels = WALL.labels.copy()
    labels[:, 80:] = -1
    unclear = labels < 0
    unclear[:, 80:90] = False
    return LabelledFrame(FRAME, ExactLabels(labels, WALL.planes, unclear))


def test_planes_on_unclear_pixels_count_in_one_table_only():
    one = halves()
    right = one.truth.labels < 0
    bold = Fixed(np.where(right, 1, one.truth.labels), np.vstack([WALL.planes, [0, 0, -1, 2]]))
    strict, lenient = frame_scores(bold, one, 0.0)
    assert (strict.recall, strict.precision) == (1, 0.5)
    assert (lenient.recall, lenient.precision) == (1, 1)
    assert lenient.segmentation_covering == 1


def test_unclear_pixels_do_not_make_a_plane_too_large():
    one = halves()
    spilt = Fixed(np.where(one.truth.unclear, 0, one.truth.labels), WALL.planes)
    strict, lenient = frame_scores(spilt, one, 0.0)
    assert strict.segmentation_covering < 0.9
    assert lenient.segmentation_covering == 1


def test_the_labels_themselves_have_a_perfect_score():
    one = halves()
    for result in frame_scores(Fixed(one.truth.labels, WALL.planes), one, 0.0):
        assert result.segmentation_covering == result.recall == result.precision == 1
        assert result.normal_error_deg == pytest.approx(0, abs=1e-4)


def test_planes_mostly_inside_a_mask_are_removed():
    labels = np.array([[0, 0, 0, 1, 1], [2, 2, -1, -1, 1]])
    there = np.array([[0, 1, 1, 0, 0], [1, 0, 1, 0, 1]], bool)
    planes = np.arange(12.0).reshape(3, 4)
    kept_labels, kept = leave_out(labels, planes, there)
    np.testing.assert_array_equal(kept_labels, [[-1, -1, -1, 0, 0], [1, 1, -1, -1, 0]])
    np.testing.assert_array_equal(kept, planes[1:])


@pytest.mark.parametrize('sigma', [0.0, 0.004])
def test_noise_depends_on_the_number_in_the_name(sigma):
    method = Fixed(WALL.labels, WALL.planes)
    segmented(method, FRAME, sigma)
    expected = WALL.depth_m if sigma == 0 else with_disparity_noise(
        WALL.depth_m, sigma, np.random.default_rng([7, 1]))
    np.testing.assert_array_equal(method.depth_m, expected)


def test_frames_are_reported_and_drawn(capsys, tmp_path):
    absent = peers.Ours()
    absent.name, absent.absent = 'nowhere', 'nothing of that name is installed'
    slow = peers.Ours()
    slow.name, slow.slow = 'slow', True
    found = [replace(FRAME, name=name) for name in ('1', '2', '3')]
    report_exact([peers.Ours(), slow, absent], [*found, replace(FRAME, set_name='real')],
                 found[:1], tmp_path / 'sheets')
    text = capsys.readouterr().out
    assert 'nowhere: absent, nothing of that name is installed.' in text
    assert '| nowhere |' not in text
    assert text.count('| plane_detector | 0.004 | 3 |') == 2, 'both tables'
    assert text.count('| plane_detector | 0.004 | 1 |') == 2, 'of the held-out frame'
    assert text.count('| slow | 0.01 | 2 |') == 2
    assert text.count('unclear pixels are left out of the count') == 2
    sheet = cv2.imread(str(tmp_path / 'sheets' / 'living_room_labels.png'))
    columns = 2 + len(SIGMAS)
    assert columns * 400 <= sheet.shape[1] < (columns + 1) * 400
    assert 3 * 300 <= sheet.shape[0] < 4 * 400


def test_without_clean_frames_nothing_is_reported(capsys, tmp_path):
    report_exact([peers.Ours()], [replace(FRAME, set_name='real')], [], tmp_path / 'sheets')
    assert capsys.readouterr().out == ''
    assert not (tmp_path / 'sheets').exists()


def test_held_out_frames_differ_from_those_used_for_tuning(tmp_path):
    folder = tmp_path / 'living_room'
    folder.mkdir()
    about = {'fx': 9.0, 'fy': 9.0, 'cx': 4.5, 'cy': 3.5, 'width': 10, 'height': 8,
             'depth_unit_m': 0.001}
    (folder / 'intrinsics.json').write_text(json.dumps(about))
    for k in range(17):
        cv2.imwrite(str(folder / f'{k:02}_depth.png'), np.full((8, 10), 1000, np.uint16))
        cv2.imwrite(str(folder / f'{k:02}_rgb.png'), np.zeros((8, 10, 3), np.uint8))
    assert [frame.name for frame in frames(tmp_path)] == ['00', '10']
    assert [frame.name for frame in held_out_frames(tmp_path)] == ['05', '15']
    assert held_out_frames(tmp_path / 'nowhere') == []
