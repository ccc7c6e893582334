# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The ways over the ground: every pixel is on one, and each leads away from the nadir."""

import numpy as np
import pytest

from plane_detector.evaluation.scenes.rendering import camera_rotation
from plane_detector.ground.ways import ways_over_ground
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(66.0, 60.0, 41.0, 27.5, 80, 60)
# Pitch down and roll.
POSES = [(0, 0), (25, 0), (25, 90), (25, 180), (25, 45), (-20, 0), (60, 130), (75, 0), (90, 0),
         (89.9, 10), (95, 10), (40, 268), (0, 45)]


def down_of(pitch_deg, roll_deg):
    return camera_rotation(0, -pitch_deg, roll_deg).T @ np.array([0.0, 0.0, -1.0])


def pixels_of(ways):
    """Return way, line, u and v of each pixel of each way."""
    found = []
    for i, (u0, v0, du, dv, start, step, first, end, low, high) in enumerate(ways.lines.tolist()):
        for way in range(first, end):
            a = min(max((start + way * step) >> 16, low), high - 1)
            for at in range(a, min(max((start + (way + 1) * step) >> 16, a + 1), high)):
                found.append((way, i, u0 + du * at, v0 + dv * at))
    return np.array(found)


@pytest.mark.parametrize('pose', POSES)
def test_every_pixel_is_on_a_way(pose):
    found = pixels_of(ways_over_ground(CAMERA, down_of(*pose)))
    seen = np.zeros((60, 80), int)
    np.add.at(seen, (found[:, 3], found[:, 2]), 1)
    assert seen.min() >= 1 and found[:, 0].min() >= 0


@pytest.mark.parametrize('camera', [CAMERA, CameraIntrinsics.from_field_of_view(640, 360, 90.0)])
@pytest.mark.parametrize('pose', POSES)
def test_the_ways_of_a_line_end_behind_its_last_pixel(camera, pose):
    """Else the last pixel would belong to a way that does not pass the line, or to none."""
    ways = ways_over_ground(camera, down_of(*pose))
    start, step, first, end, high = ways.lines[:, [4, 5, 6, 7, 9]].T
    assert ((start + end * step) >> 16 >= high).all()
    assert first.min() >= 0 and (first < end).all() and end.max() == ways.count


@pytest.mark.parametrize('pose', POSES)
def test_ways_lead_away_from_the_nadir(pose):
    """On the floor, each step is away from the foot of the camera, hardly to a side."""
    down = down_of(*pose)
    found = pixels_of(ways_over_ground(CAMERA, down))
    rays = np.column_stack([(found[:, 2] - 41.0) / 66.0, (found[:, 3] - 27.5) / 60.0,
                            np.ones(len(found))])
    for way in np.unique(found[:, 0])[::7]:
        mine = (found[:, 0] == way) & (rays @ down > 0.1)
        points = rays[mine] / (rays[mine] @ down)[:, None]
        level = points - (points @ down)[:, None] * down
        far = np.linalg.norm(level, axis=1)
        middle = len(far) // 2
        if len(far) > 10 and far[middle] > 0.3:
            assert far[-1] > far[middle] > far[0]
            sine = np.linalg.norm(np.cross(level[-1], level[middle])) / (far[-1] * far[middle])
            assert sine < 0.1


def test_a_level_camera_has_its_columns_as_ways():
    lines = ways_over_ground(CAMERA, np.array([0.0, 1.0, 0.0])).lines
    assert lines[:, 1].tolist() == list(range(59, -1, -1)) and (lines[:, 5] == 1 << 16).all()
