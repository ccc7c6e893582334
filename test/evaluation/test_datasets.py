# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Real images are read in metres and RGB, planes judged by them, other methods compared."""

import numpy as np
import pytest
from data_files import write_frame

from plane_detector.evaluation import peers
from plane_detector.evaluation.datasets import (
    NO_PLANE,
    UNKNOWN,
    frames,
    labelled_frames,
    numbered,
)
from plane_detector.evaluation.metrics import score
from plane_detector.evaluation.reference_planes import fit_planes, judge_planes, plane_depth
from plane_detector.evaluation.scenes.rooms import random_room, single_wall
from plane_detector.types import CameraIntrinsics


def test_frames_are_read_in_metres_and_rgb(tmp_path):
    depth_mm = np.full((120, 160), 2500, np.uint16)
    depth_mm[0] = 0
    write_frame(tmp_path / 'living_room', depth_mm)
    (frame,) = frames(tmp_path)
    assert (frame.set_name, frame.name) == ('living_room', '7')
    assert frame.depth_m[1, 0] == pytest.approx(2.5)
    assert np.isnan(frame.depth_m[0]).all()
    np.testing.assert_array_equal(frame.rgb[0, 0], [30, 20, 10])


def test_missing_or_mismatched_frames_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match='nowhere'):
        list(frames(tmp_path / 'nowhere'))
    write_frame(tmp_path / 'set', np.ones((60, 80), np.uint16))
    with pytest.raises(FileNotFoundError, match='no set other, only set'):
        list(frames(tmp_path, ('other',)))
    with pytest.raises(ValueError, match='160 x 120'):
        list(frames(tmp_path))


def test_labels_made_by_hand_fit_their_depth(data_folder):
    found = {f'{one.set_name}/{one.name}': one for one in labelled_frames(data_folder)}
    if not found:
        pytest.skip('no labelled frames')
    table = found['osd_tabletop/test63']
    assert set(np.unique(table.labels)) == {UNKNOWN, NO_PLANE, 0}
    # Label 1 of this frame is two surfaces: left out, and the others are numbered without gaps.
    assert set(np.unique(found['nyu_planes_dpd/nyu0412'].labels)) == {UNKNOWN, *range(8)}
    for name, limit_m in (('abw/02', 0.003), ('icl_office_evops/office_0000', 0.001),
                          ('nyu_planes_dpd/nyu0619', 0.03)):
        one = found[name]
        fitted_m = plane_depth(one.labels, fit_planes(one.labels, one.depth_m, one.intrinsics),
                               one.intrinsics)
        off_m = np.abs(fitted_m - one.depth_m)[one.labels == np.argmax(
            np.bincount(one.labels[one.labels >= 0]))]
        assert np.nanmedian(off_m) < limit_m


CAMERA = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)


def test_a_plane_is_judged_by_hand():
    """Of a predicted plane at 2.1 m, three quarters lie on a wall at 2 m, the rest is further."""
    sensor_m = np.full((120, 160), 2.0)
    sensor_m[:, 120:] = 3.0
    labels = np.zeros(sensor_m.shape, np.int32)
    tilted = np.radians(10)
    planes = np.array([[0, np.sin(tilted), -np.cos(tilted), 2.1]])
    (judged,) = judge_planes(labels, planes, sensor_m, CAMERA, np.random.default_rng(0))
    assert judged.purity == pytest.approx(0.75)
    assert judged.normal_error_deg == pytest.approx(10, abs=0.1)


@pytest.mark.parametrize(('distance_m', 'stray_m', 'purity'), [
    (1.0, 0.029, 1), (1.0, 0.04, 7 / 8), (4.0, 0.057, 1), (4.0, 0.075, 7 / 8)])
def test_the_tolerance_is_3_cm_or_a_share_of_the_depth(distance_m, stray_m, purity):
    sensor_m = np.full((120, 160), distance_m, np.float32)
    sensor_m[:, ::16] += stray_m
    sensor_m[:, 8::16] -= stray_m
    (judged,) = judge_planes(np.zeros(sensor_m.shape, int), np.array([[0, 0, -1, distance_m]]),
                             sensor_m, CAMERA, np.random.default_rng(0))
    assert judged.purity == pytest.approx(purity)


def test_the_depth_of_a_plane_is_where_the_rays_meet_it():
    scene = random_room(np.random.default_rng(2), CAMERA)
    np.testing.assert_allclose(plane_depth(scene.labels, scene.planes, CAMERA), scene.depth_m,
                               rtol=1e-4)
    nothing = np.full((120, 160), -1)
    assert np.isnan(plane_depth(nothing, scene.planes[:0], CAMERA)).all()


def test_planes_are_fitted_to_their_pixels():
    scene = random_room(np.random.default_rng(2), CAMERA)
    np.testing.assert_allclose(fit_planes(scene.labels, scene.depth_m, CAMERA), scene.planes,
                               atol=2e-3)


@pytest.mark.parametrize('method', peers.all_methods(), ids=lambda method: method.name)
def test_every_method_finds_a_wall_or_says_why_it_cannot(method):
    if method.absent:
        pytest.skip(method.absent)
    wall = single_wall(CAMERA, yaw_deg=20, distance_m=2.0)
    labels, planes = method(wall.depth_m, CAMERA)
    result = score(wall.labels, wall.planes, labels, planes, np.isfinite(wall.depth_m))
    assert labels.shape == (120, 160)
    assert labels.max() == len(planes) - 1
    assert result.recall == 1
    assert result.normal_error_deg < 1
    assert result.offset_error_m < 0.02
    assert (planes[:, 3] >= 0).all()


def test_labels_are_renumbered_without_gaps():
    values = np.array([[0, 7], [3, 7]])
    np.testing.assert_array_equal(numbered(values, values > 0), [[-1, 1], [0, 1]])
