# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of the axes that planes have in common."""

from dataclasses import replace

import cv2
import numpy as np

from plane_detector.directions.vanishing import NO_PAIRS, SceneDirections
from plane_detector.planes.plane_axes import axes_of_planes

SIGMA_RAD = np.radians(0.5)


def rotation(degrees, about):
    return cv2.Rodrigues(np.radians(degrees) * np.asarray(about, float))[0]


ROOM = rotation(20, [0.6, 0.0, 0.8])  # rows: across, down, ahead


def planes(rng, off_deg=0.5):
    """Return normals along all axes of the room, with errors, and one of no axis."""
    normals = np.concatenate([ROOM, -ROOM, ROOM, [[0.5, 0.5, np.sqrt(0.5)]]])
    normals = normals + np.radians(off_deg) * rng.standard_normal(normals.shape)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def lines(turn, probability=1.0):
    """Return directions whose axes are those of the room, turned."""
    across, down, ahead = ROOM @ turn.T
    covariance = np.radians(1.0) ** 2 * (np.eye(3) - np.outer(down, down))
    return SceneDirections(down, covariance, np.stack([across, ahead])[None],
                           probability=probability)


def axes(normals, of_lines, factor=1.0):
    """Return the axes of planes whose errors have a variance of this times SIGMA_RAD squared."""
    return axes_of_planes(normals, np.full(len(normals), factor * SIGMA_RAD**2), of_lines)


def angle_deg(a, b):
    return np.degrees(np.arccos(np.clip(np.abs(a @ b), 0, 1)))


def test_axes_are_those_of_the_planes_whatever_the_lines():
    normals = planes(np.random.default_rng(0))
    own, _ = axes(normals, lines(rotation(15, [0, 0, 1])))
    assert angle_deg(own.gravity_camera, ROOM[1]) < 0.5
    assert own.gravity_camera @ ROOM[1] > 0
    assert angle_deg(own.pairs[0], ROOM[0]).min() < 0.5
    # Nine planes, each with two components of its error, leave a third of it for each axis.
    sigma_rad = np.sqrt(np.trace(own.covariance) / 2)
    assert 0.25 * SIGMA_RAD < sigma_rad < 0.5 * SIGMA_RAD


def test_axes_far_from_those_of_sure_lines_are_improbable():
    normals = planes(np.random.default_rng(1))
    near, far, unsure, other_azimuth = (
        axes(normals, one)[1]
        for one in (lines(rotation(0.5, [0, 0, 1])), lines(rotation(15, [0, 0, 1])),
                    lines(rotation(15, [0, 0, 1]), 0.9), lines(rotation(15, ROOM[1]))))
    assert far < unsure < near
    assert far < other_azimuth < near


def test_accurate_planes_need_more_agreement_than_inaccurate_ones():
    normals = planes(np.random.default_rng(2))
    wrong = lines(rotation(15, [0, 0, 1]))
    sharp, blurred = (axes(normals, wrong, factor) for factor in (1, 16))
    assert sharp[1] < blurred[1]


def test_without_horizontal_axes_of_the_lines_any_azimuth_is_as_likely():
    normals = planes(np.random.default_rng(3))
    priors = [axes(normals, replace(lines(turn), pairs=NO_PAIRS))[1]
              for turn in (np.eye(3), rotation(30, ROOM[1]))]
    assert abs(priors[0] - priors[1]) < 1e-9


def test_if_the_vertical_of_the_lines_is_wrong_so_may_be_their_azimuth():
    normals = planes(np.random.default_rng(4))
    priors = [axes(normals, lines(rotation(15, [0, 0, 1]) @ turn))[1]
              for turn in (np.eye(3), rotation(30, ROOM[1]))]
    assert abs(priors[0] - priors[1]) < 1e-3


def test_axes_without_support_of_the_lines_are_those_of_a_camera_held_upright():
    level, wrong = planes(np.random.default_rng(5)) @ ROOM.T, rotation(15, [1, 0, 0])
    held, on_its_side = (axes(level @ roll.T, lines(roll @ wrong @ ROOM))[1]
                         for roll in (np.eye(3), rotation(25, [0, 0, 1])))
    assert on_its_side < held - 1


def test_parallel_planes_have_no_axes():
    normals = np.tile(ROOM[1], (3, 1))
    assert axes(normals, lines(np.eye(3)))[0] is None
