# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What holds for the planes of any depth image, and how they follow when the scene changes."""

import numpy as np
import pytest
from cell_helpers import relative_labels

from plane_detector import CameraIntrinsics, segment_planes
from plane_detector.evaluation.metrics import overlap, segmentation_covering
from plane_detector.evaluation.peers import plane_array
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rooms import VGA, Rectangle, box, camera_rotation, render

SEEDS = (3, 7)
SIGMAS = (0.0, 0.004)


def noisy(scene, sigma, seed):
    if sigma == 0:
        return scene.depth_m
    return with_disparity_noise(scene.depth_m, sigma, np.random.default_rng(seed))


def assert_follows(before, after, labels, planes, sigma, covering=0.9):
    """
    Check a segmentation against the one before the scene was changed.

    ``labels`` are those of ``after`` brought back to the pixels of ``before``, and ``planes`` the
    ones of ``before`` moved as the scene was.
    """
    shared = overlap(before.labels, labels, np.ones(labels.shape, bool))
    assert segmentation_covering(shared.counts) > covering
    found = plane_array(after)
    large = shared.counts[:-1].sum(1) > 0.01 * labels.size
    same = shared.iou > 0.8
    assert same[large].any(axis=1).mean() >= (1.0 if sigma == 0 else 0.75)
    for i, j in zip(*np.nonzero(same & large[:, None]), strict=True):
        cosine = np.clip(planes[i, :3] @ found[j, :3], -1, 1)
        deviation_deg = np.degrees(np.sqrt(np.trace(before.planes[i].covariance[:3, :3])))
        assert np.degrees(np.arccos(cosine)) < (0.1 if sigma == 0 else max(5, deviation_deg))
        assert abs(planes[i, 3] - found[j, 3]) < (1e-3 if sigma == 0 else 0.08) * max(
            1, planes[i, 3])


FLIPS = {'mirrored': (np.s_[:, ::-1], (-1, 1, 1)), 'upside down': (np.s_[::-1], (1, -1, 1)),
         'turned by 180 degrees': (np.s_[::-1, ::-1], (-1, -1, 1))}


@pytest.mark.parametrize(('seed', 'sigma'), [(3, 0.0), (7, 0.004)])
@pytest.mark.parametrize('flip', FLIPS)
def test_a_flipped_image_has_the_planes_flipped(room, flip, seed, sigma):
    index, signs = FLIPS[flip]
    depth_m = noisy(room(seed), sigma, seed)
    before = segment_planes(depth_m, VGA)
    after = segment_planes(depth_m[index], VGA)
    assert_follows(before, after, after.labels[index], plane_array(before) * [*signs, 1], sigma)


@pytest.mark.parametrize(('seed', 'sigma'), [(3, 0.0), (7, 0.004)])
def test_an_image_turned_by_90_degrees_has_the_planes_turned(room, seed, sigma):
    depth_m = noisy(room(seed), sigma, seed)
    upright = CameraIntrinsics(VGA.fy, VGA.fx, VGA.cy, VGA.width - 1 - VGA.cx, VGA.height,
                               VGA.width)
    before = segment_planes(depth_m, VGA)
    after = segment_planes(np.rot90(depth_m), upright)
    # Turned to the left, what was right is up and what was down is right.
    turned = plane_array(before)[:, [1, 0, 2, 3]] * [1, -1, 1, 1]
    assert_follows(before, after, np.rot90(after.labels, -1), turned, sigma)


@pytest.mark.parametrize('factor', [0.5, 3.0])
@pytest.mark.parametrize('seed', SEEDS)
def test_a_scene_of_another_size_has_the_planes_at_that_distance(room, seed, factor):
    depth_m = room(seed).depth_m
    before = segment_planes(depth_m, VGA)
    after = segment_planes(depth_m * np.float32(factor), VGA)
    assert_follows(before, after, after.labels, plane_array(before) * [1, 1, 1, factor], 0.0)


def furnished(rotation, position, far_wall=False):
    """Return an open space of simple furniture; behind it nothing, or a wall 40 m away."""
    faces = [Rectangle(np.array([-2.0, 0.5, 0]), np.array([4.0, 0, 0]), np.array([0, 4.5, 0])),
             *box(np.array([-0.9, 3.0, 0.4]), np.array([0.9, 0.7, 0.8]), 20.0),
             *box(np.array([0.8, 3.6, 0.6]), np.array([0.8, 0.8, 1.2]), -30.0)]
    if far_wall:
        faces.append(Rectangle(np.array([-90.0, 40, -60]), np.array([180.0, 0, 0]),
                               np.array([0, 0, 120.0])))
    return render(faces, rotation, position, VGA, np.random.default_rng(0))


@pytest.mark.parametrize('sigma', SIGMAS)
def test_a_plane_far_away_changes_none_of_the_others(sigma):
    rotation, position = camera_rotation(0, -10, 0), np.array([0, 0, 1.5])
    near, both = (furnished(rotation, position, far) for far in (False, True))
    seen = np.isfinite(near.depth_m)
    noisy_m = noisy(both, sigma, 5)
    before = segment_planes(np.where(seen, noisy_m, np.nan), VGA)
    after = segment_planes(noisy_m, VGA)
    labels = np.where(seen, after.labels, -1)
    assert_follows(before, after, labels, plane_array(before), sigma, covering=0.95)
    assert len(after.planes) == len(before.planes) + 1


@pytest.mark.parametrize('sigma', SIGMAS)
@pytest.mark.parametrize(('factor', 'shift'), [(1.0, 0.3), (37.0, -5.0), (0.013, 0.002)])
def test_scale_and_shift_of_disparity_change_hardly_a_label(room, factor, shift, sigma):
    """Only the rounding of float32 may decide otherwise."""
    disparity = 1 / noisy(room(SEEDS[1]), sigma, 0)
    before = relative_labels(disparity)
    after = relative_labels((factor * disparity + shift).astype(np.float32))
    # Labels may have other numbers: each is compared with the one it shares most pixels with.
    pairs = np.bincount((before + 1).ravel() * 300 + after.ravel() + 1, minlength=300**2)
    assert pairs.reshape(300, 300).max(axis=1).sum() > 0.99 * before.size


@pytest.mark.parametrize('sigma', SIGMAS)
def test_the_same_seed_gives_the_same_planes(room, sigma):
    depth_m = noisy(room(SEEDS[0]), sigma, 0)
    first, again, handed = (
        segment_planes(depth_m, VGA, rng=rng) for rng in (None, None, np.random.default_rng(0)))
    for other in (again, handed):
        np.testing.assert_array_equal(first.labels, other.labels)
        np.testing.assert_array_equal(plane_array(first), plane_array(other))
