# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What holds for the planes of any depth image, and how they follow when the scene changes."""

import numpy as np
import pytest
from cell_helpers import noisy, rectangle, relative_labels

from plane_detector import CameraIntrinsics, segment_planes
from plane_detector.evaluation.metrics import angle_deg, overlap, segmentation_covering
from plane_detector.evaluation.peers import plane_array
from plane_detector.evaluation.scenes.rendering import VGA, box, camera_rotation, render

SIGMAS = (0.0, 0.004)


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
        deviation_deg = np.degrees(np.sqrt(np.trace(before.planes[i].covariance[:3, :3])))
        assert angle_deg(planes[i, :3], found[j, :3]) < (
            0.1 if sigma == 0 else max(5, deviation_deg))
        assert abs(planes[i, 3] - found[j, 3]) < (1e-3 if sigma == 0 else 0.08) * max(
            1, planes[i, 3])


UPRIGHT = CameraIntrinsics(VGA.fy, VGA.fx, VGA.cy, VGA.width - 1 - VGA.cx, VGA.height, VGA.width)
# The depth changed, its camera, the labels brought back, and the axes of the normals with the
# signs of the planes. Turned to the left, what was right is up and what was down is right.
CHANGES = {
    'mirrored': (lambda d: d[:, ::-1], VGA, lambda k: k[:, ::-1], [0, 1, 2, 3], [-1, 1, 1, 1]),
    'upside down': (lambda d: d[::-1], VGA, lambda k: k[::-1], [0, 1, 2, 3], [1, -1, 1, 1]),
    'turned by 180 degrees': (lambda d: d[::-1, ::-1], VGA, lambda k: k[::-1, ::-1],
                              [0, 1, 2, 3], [-1, -1, 1, 1]),
    'turned by 90 degrees': (np.rot90, UPRIGHT, lambda k: np.rot90(k, -1), [1, 0, 2, 3],
                             [1, -1, 1, 1]),
    'half as large': (lambda d: d * np.float32(0.5), VGA, np.array, [0, 1, 2, 3], [1, 1, 1, 0.5]),
    'three times as large': (lambda d: d * np.float32(3), VGA, np.array, [0, 1, 2, 3],
                             [1, 1, 1, 3])}


@pytest.mark.parametrize(('seed', 'sigma'), [(3, 0.0), (7, 0.004)])
@pytest.mark.parametrize('change', CHANGES)
def test_planes_follow_the_image(room, change, seed, sigma):
    changed, camera, brought_back, axes, factors = CHANGES[change]
    if 'large' in change:
        sigma = 0.0  # the noise would grow too
    depth_m = noisy(room(seed), seed, sigma)
    before, after = segment_planes(depth_m, VGA), segment_planes(changed(depth_m), camera)
    assert_follows(before, after, brought_back(after.labels),
                   plane_array(before)[:, axes] * factors, sigma)


@pytest.mark.parametrize('sigma', SIGMAS)
def test_a_plane_far_away_changes_none_of_the_others(sigma):
    """Behind an open space of simple furniture there is nothing, or a wall 40 m away."""
    faces = [rectangle([-2, 0.5, 0], [4, 0, 0], [0, 4.5, 0]),
             *box(np.array([-0.9, 3.0, 0.4]), np.array([0.9, 0.7, 0.8]), 20.0),
             *box(np.array([0.8, 3.6, 0.6]), np.array([0.8, 0.8, 1.2]), -30.0)]
    near, both = (render(one, camera_rotation(0, -10, 0), np.array([0, 0, 1.5]), VGA,
                         np.random.default_rng(0))
                  for one in (faces, [*faces, rectangle([-90, 40, -60], [180, 0, 0],
                                                        [0, 0, 120])]))
    seen, noisy_m = np.isfinite(near.depth_m), noisy(both, 5, sigma)
    before = segment_planes(np.where(seen, noisy_m, np.nan), VGA)
    after = segment_planes(noisy_m, VGA)
    assert_follows(before, after, np.where(seen, after.labels, -1), plane_array(before), sigma,
                   covering=0.95)
    assert len(after.planes) == len(before.planes) + 1


@pytest.mark.parametrize('sigma', SIGMAS)
@pytest.mark.parametrize(('factor', 'shift'), [(1.0, 0.3), (37.0, -5.0), (0.013, 0.002)])
def test_scale_and_shift_of_disparity_change_hardly_a_label(room, factor, shift, sigma):
    """Only the rounding of float32 may decide otherwise."""
    disparity = 1 / noisy(room(7), 0, sigma)
    before = relative_labels(disparity)
    after = relative_labels((factor * disparity + shift).astype(np.float32))
    # Labels may have other numbers: each is compared with the one it shares most pixels with.
    shared = overlap(before, after, np.ones(before.shape, bool)).counts
    assert shared.max(axis=1).sum() > 0.99 * before.size


@pytest.mark.parametrize('sigma', SIGMAS)
def test_the_same_seed_gives_the_same_planes(room, sigma):
    depth_m = noisy(room(3), 0, sigma)
    first, again, handed = (
        segment_planes(depth_m, VGA, rng=rng) for rng in (None, None, np.random.default_rng(0)))
    for other in (again, handed):
        np.testing.assert_array_equal(first.labels, other.labels)
        np.testing.assert_array_equal(plane_array(first), plane_array(other))
