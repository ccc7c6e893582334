# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Real images are read in metres and RGB, and their errors are reported."""

import numpy as np
import pytest
from frame_files import write_frame

from plane_detector.evaluation.datasets import (
    NO_PLANE,
    UNKNOWN,
    frames,
    labelled_frames,
)
from plane_detector.evaluation.reference_planes import fit_planes, plane_depth


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
