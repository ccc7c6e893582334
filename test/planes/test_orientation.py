# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of the orientation of planes by depth, lines and axes."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from plane_detector.directions.line_segments import segments_from_pixels
from plane_detector.directions.vanishing import NO_PAIRS, SceneDirections
from plane_detector.evaluation.metrics import angle_deg
from plane_detector.geometry.robust import SIGMA_PER_MEDIAN
from plane_detector.planes import orientation
from plane_detector.planes.line_evidence import LineEvidence, lines_in_regions
from plane_detector.planes.orientation import most_likely, score_orientations
from plane_detector.planes.region_samples import RegionSamples
from plane_detector.types import CameraIntrinsics, Plane, Planes

AXES = np.array([[0.0, 1.0, 0.0], [0.8, 0.0, 0.6], [-0.6, 0.0, 0.8]])
SHARE = 0.06  # of the image


def directions(pairs=True):
    covariance = np.radians(1.0) ** 2 * (np.eye(3) - np.outer(AXES[0], AXES[0]))
    return SceneDirections(AXES[0], covariance, AXES[None, 1:] if pairs else NO_PAIRS)


def plane(normal, sigma_deg=1.0):
    normal = np.asarray(normal, float) / np.linalg.norm(normal)
    covariance = np.zeros((4, 4))
    covariance[:3, :3] = np.radians(sigma_deg) ** 2 * (np.eye(3) - np.outer(normal, normal))
    return Plane(normal, 2.0, -2 * normal, 1000, 0.1, 1.0, covariance, 0.9)


def turned(normal, angle_deg, about):
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return c * normal + s * np.cross(about, normal) + (1 - c) * (about @ normal) * about


def no_lines(count):
    return LineEvidence(AXES, np.zeros((count, 3)))


def samples_of(planes, rays):
    """Return samples of regions, each with these rays (n, 3), in turn before and behind it."""
    rays = np.asarray(rays, float)
    cosine = np.concatenate([-rays @ p.normal for p in planes])
    return RegionSamples(np.tile(rays, (len(planes), 1)), bent(cosine / 2.0),
                         np.repeat(np.arange(len(planes)), len(rays)), cosine,
                         np.full(len(planes), SHARE))


def bent(disparity):
    """Return disparities in turn above and below by what a bend of 10 cm at 2 m does."""
    share = 0.1 / 2.0 / SIGMA_PER_MEDIAN
    return disparity * (1 + share * np.where(np.arange(len(disparity)) % 2, 1, -1))


def orient(planes, found, evidence):
    """Orient planes that are each seen in one spot: the depth excludes no rotation."""
    count = len(planes)
    spots = RegionSamples(np.stack([-p.normal for p in planes]).repeat(2, axis=0),
                          bent(np.full(2 * count, 0.5)), np.arange(count).repeat(2),
                          np.ones(2 * count), np.full(count, SHARE))
    return most_likely(score_orientations(Planes.of(planes), found, evidence, spots), spots,
                       np.ones(count))


def test_planes_near_an_axis_are_turned_to_it():
    planes = (plane(turned(-AXES[0], 12, AXES[1])), plane(turned(-AXES[2], 12, AXES[0])))
    found = orient(planes, directions(), no_lines(2))
    assert found.is_changed.all()
    assert angle_deg(found.normals[0], -AXES[0]) < 0.5
    assert angle_deg(found.normals[1], -AXES[2]) < 0.5


def test_a_floor_faces_the_camera_even_if_the_network_sees_it_lean_over():
    below = [[x, y, 1.0] for x in (-0.3, 0.0, 0.3) for y in (0.6, 0.7)]
    leaning = plane(turned(-AXES[2], 5, AXES[1]))
    assert leaning.normal @ AXES[0] > 0
    lines = LineEvidence(AXES, np.array([[0.0, 0.5, 0.45]]))
    pieces = replace(samples_of((leaning,), below), image_shares=np.array([0.01]))
    planes = Planes.of([leaning])
    found = most_likely(score_orientations(planes, directions(), lines, pieces), pieces,
                        np.ones(1))
    assert angle_deg(found.normals[0], -AXES[0]) < 1


def grid_of_rays(x, y, half=0.2):
    """Return rays (36, 3) about the pixel at (x, y) of the image at unit focal length."""
    side = np.linspace(-half, half, 6)
    return [[x + dx, y + dy, 1.0] for dx in side for dy in side]


def class_probability(true_normal, network_normal, rays, bend=0.1, colours=1.0):
    """Return that of a plane whose depth is that of the network's normal, with some bend."""
    seen = plane(network_normal)
    samples, planes = samples_of((seen,), rays), Planes.of([seen])
    flat = samples.own_cosine / seen.offset_m
    samples = replace(samples, disparity=flat + bend * (samples.disparity - flat))
    found = most_likely(score_orientations(planes, directions(), no_lines(1), samples), samples,
                        np.array([colours]))
    assert angle_deg(found.normals[0], true_normal) < 1
    return found.class_probability[0]


def test_the_more_a_piece_is_bent_the_less_sure_is_its_class():
    near, rays = turned(-AXES[2], 10, AXES[1]), grid_of_rays(0, 0, 0.01)
    flat, less, more, most = (class_probability(-AXES[2], near, rays, bend, colours=3.0)
                              for bend in (0.1, 0.3, 1.0, 2.0))
    assert flat > 0.9
    assert less > more > most
    assert most < 0.75


def test_the_farther_the_depth_is_from_the_plane_the_less_sure_is_its_class():
    """The same turn changes the depth of a wide piece by more, as a share."""
    narrow, wide = (class_probability(-AXES[2], turned(-AXES[2], 20, AXES[1]),
                                      grid_of_rays(0, 0, half), bend=0.3) for half in (0.02, 0.4))
    assert wide < narrow - 0.02


def test_the_more_colours_a_piece_has_the_less_sure_is_its_class():
    near, rays = turned(-AXES[2], 10, AXES[1]), grid_of_rays(0, 0, 0.01)
    one, many = (class_probability(-AXES[2], near, rays, 1.0, colours) for colours in (1.0, 16.0))
    assert many < one - 0.1


def test_a_level_piece_near_the_horizon_is_less_sure_than_one_below():
    """Both are as far from the network's depth, as shares of the depth."""
    def seen_at(height):
        rays = [[height * x, height, 1.0] for x in np.linspace(-0.2, 0.2, 36)]
        return class_probability(-AXES[0], -AXES[0], rays, bend=2.0)

    assert seen_at(0.2) < seen_at(1.0) - 0.05


def test_an_accurate_network_keeps_a_roof_and_an_open_door():
    roof, door = turned(-AXES[0], 35, AXES[1]), turned(-AXES[2], 30, AXES[0])
    exact = tuple(plane(turned(normal, 0.5, AXES[1]), 0.3)
                  for normal in (-AXES[0], -AXES[2], AXES[1], -AXES[0], -AXES[2]))
    found = orient((*exact, plane(roof, 0.3), plane(door, 0.3)), directions(),
                          no_lines(7))
    assert found.sigmas_rad.max() <= np.radians(3.0)
    assert angle_deg(found.normals[5], roof) < 1
    assert angle_deg(found.normals[6], door) < 1


@pytest.mark.parametrize(('line', 'expected'), [(1, 2), (2, 1)])
def test_lines_along_an_axis_are_in_no_plane_across_it(line, expected):
    between = turned(-AXES[2], 45, -AXES[0])
    if between @ AXES[1] < 0:
        between = turned(-AXES[2], 45, AXES[0])
    shares = np.zeros((1, 3))
    shares[0, line] = 0.8
    found = orient((plane(between, 8.0),), directions(), LineEvidence(AXES, shares))
    assert abs(found.normals[0] @ AXES[expected]) > 0.999


def test_lines_outvote_a_normal_that_is_plainly_wrong():
    wrong = turned(turned(-AXES[2], 68, -AXES[0]), 35, AXES[2])
    if wrong @ AXES[1] < 0:
        wrong = turned(turned(-AXES[2], 68, AXES[0]), 35, AXES[2])
    evidence = LineEvidence(AXES, np.array([[0.45, 0.3, 0.0]]))
    found = orient((plane(wrong, 20.0),), directions(), evidence)
    assert abs(found.normals[0] @ AXES[2]) > 0.999


@pytest.mark.parametrize(('depth_share', 'expected_deg'), [(1.0, 0.0), (1.1, 36.0)])
def test_a_piece_that_noise_cuts_out_of_a_wall_is_the_wall(depth_share, expected_deg):
    wall = plane(-AXES[2], 0.3)
    exact = [plane(turned(-AXES[2], off_deg, AXES[0]), 0.3) for off_deg in (-0.3, 0.3, -0.2, 0.2)]
    piece = plane(turned(-AXES[2], 36, np.array([0.64, 0.6, 0.48])), 7.0)
    planes = (wall, *exact, piece)
    rays = np.array([[x, y, 1.0] for x in (-0.01, 0.01) for y in np.linspace(-0.01, 0.01, 20)])
    samples = samples_of(planes, rays)
    disparity = -rays @ wall.normal / wall.offset_m
    noise = 1 + 0.01 * np.random.default_rng(0).standard_normal((len(planes), len(rays)))
    noise[-1] /= depth_share
    samples = replace(samples, disparity=(disparity * noise).ravel(),
                      image_shares=np.array([0.3, 0.1, 0.1, 0.1, 0.1, 0.005]))
    scored = score_orientations(Planes.of(planes), directions(), no_lines(len(planes)), samples)
    found = most_likely(scored, samples, np.ones(len(planes)))
    assert angle_deg(found.normals[-1], wall.normal) == pytest.approx(expected_deg, abs=1.0)


def test_lines_belong_to_the_regions_on_their_sides():
    camera = CameraIntrinsics(100.0, 100.0, 49.5, 49.5, 100, 100)
    labels = np.zeros((100, 100), np.int32)
    labels[:, 50:] = 1
    segments = segments_from_pixels(np.array([[[20.0, 10.0], [20.0, 90.0]],
                                              [[60.0, 30.0], [90.0, 30.0]]]), camera)
    evidence = lines_in_regions(segments, labels, 2).along(np.eye(3)[:2])
    # The upright line runs along y and is in region 0, the level one along x and in region 1.
    assert evidence.shares[0] == pytest.approx([0, 0.8 / (0.8 + 0.15)])
    assert evidence.shares[1] == pytest.approx([0.3 / (0.3 + 0.15), 0])
    normals = np.array([[[0, 1, 0], [1, 0, 0]], [[0, 1, 0], [1, 0, 0]]], float)
    contradiction = evidence.contradiction(normals)
    assert contradiction[0] == pytest.approx([0.8 / 0.95, 0])
    assert contradiction[1] == pytest.approx([0, 0.3 / 0.45])


def test_an_object_before_the_floor_is_no_part_of_it_however_poor_the_network():
    """Its depth is three times the largest spread off, and its noise twice that."""
    level = np.array([[0.0, -1.0, 0.0]] * 2)
    hypotheses = SimpleNamespace(normals=level[:, None], freedoms=np.zeros(1))
    samples = SimpleNamespace(
        offsets=lambda normals: np.ones(2), roughness=np.full(2, 0.3),
        image_shares=np.array([0.1, 0.3]),
        distances_to_planes=lambda normals, offsets: np.array([[0.0, 0.45], [0.45, 0.0]]))
    log_odds = orientation._same_surface(hypotheses, level, np.radians(20.0), samples)
    assert 0 < log_odds[0, 0] < 0.1
    assert log_odds[1, 0] == 0, 'the larger one is no part of the smaller one'
