# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Comparison of real images with the planes of their sensor."""

import cv2
import numpy as np
import pytest
from frame_files import write_frame

from plane_detector.evaluation.benchmark.real_images import (
    compare,
    report_consistency,
    write_sheets,
)
from plane_detector.evaluation.datasets import frames
from plane_detector.evaluation.scenes.rooms import single_wall
from plane_detector.types import CameraIntrinsics

SMALL = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)
WALL = single_wall(SMALL, yaw_deg=0, distance_m=2.0)


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


def test_every_real_frame_has_planes_by_its_sensor(data_folder):
    names = []
    for frame in frames(data_folder, ('nyu', 'kinect')):
        found = compare(frame, None).sensor
        names.append(frame.name)
        assert 4 <= len(found.planes) <= 32
        seen = np.isfinite(frame.depth_m)
        assert (found.labels[seen] >= 0).mean() > 0.6
    assert len(names) == 8


def test_a_depth_camera_is_not_treated_as_a_network(data_folder):
    """A Kinect is good to an eighth of a pixel, 0.003 per metre, also in a cluttered room."""
    noise = {frame.name: compare(frame, None).sensor.disparity_noise
             for frame in frames(data_folder, ('nyu', 'kinect'))}
    assert max(noise.values()) < 0.005, noise
    assert min(noise.values()) > 0.0005, noise
