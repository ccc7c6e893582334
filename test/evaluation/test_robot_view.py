# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The moving picture of the README shows what is there: ground, the flat box, the edge."""

import numpy as np

from plane_detector.evaluation import robot_view
from plane_detector.geometry.projection import depth_to_points


def test_the_picture_shows_the_flat_box_and_the_edge_where_they_are():
    shares = np.linspace(0, 1, 3)
    for share, (rgb, found) in zip(shares, robot_view.drive(3), strict=True):
        rotation, position = robot_view.pose(share)
        edge_m = found.drops_m @ rotation.T + position
        assert len(edge_m) > 20
        assert abs(np.median(edge_m[:, 1]) - robot_view.EDGE_M) < 0.1
        assert abs(np.median(edge_m[:, 2])) < 0.03
        x, y, z = np.moveaxis(
            depth_to_points(found.depth_m, robot_view.CAMERA) @ rotation.T + position, -1, 0)
        is_floor = (y < robot_view.EDGE_M - 0.3) & (abs(z) < 0.01) & (abs(x) < 1.6)
        assert found.ground[is_floor].mean() > 0.97
        picture = robot_view.framed(rgb, found)
        right = picture[:, picture.shape[1] // 2:].reshape(-1, 3)
        for _, colour in robot_view.LEGEND:
            assert (abs(right - np.array(colour, int)).max(axis=1) < 40).any()
    # The box of 8 cm is behind the camera at the end.
    rotation, position = robot_view.pose(0.0)
    _, found = next(robot_view.drive(1))
    x, y, z = np.moveaxis(
        depth_to_points(found.depth_m, robot_view.CAMERA) @ rotation.T + position, -1, 0)
    top = (abs(x - 0.5) < 0.08) & (abs(y - 2.2) < 0.08) & (abs(z - 0.08) < 0.02)
    assert found.obstacles[top].mean() > 0.9
