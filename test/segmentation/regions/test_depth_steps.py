# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Steps cut regions apart, noise, quantisation and holes do not."""

from functools import cache

import numpy as np
import pytest
from cell_helpers import (
    EXACT,
    best_iou,
    cell_model,
    disparity_image,
    frame_of,
    one_patch,
    rectangle,
    view,
    wall,
)

from plane_detector import segment_planes
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rooms import VGA
from plane_detector.segmentation.cells.grid import build_cell_grid
from plane_detector.segmentation.cells.noise import estimate_noise
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.regions.depth_steps import split_at_depth_steps

SIGMA = 0.01
WALL_M = 2.5
FRAMES = {'wide': (-0.35, -0.25, 0.8, 0.6), 'high': (-0.3, -0.4, 0.6, 0.8)}


@cache
def framed(frame, gap_m):
    """Return a wall with a picture frame of 60 x 80 cm that is so far off it."""
    left, low, width, height = FRAMES[frame]
    return view([wall(WALL_M), rectangle([left, WALL_M - gap_m, low], [width, 0, 0],
                                         [0, 0, height])])


@cache
def bare(seed):
    """Return the depth of the wall under noise, half of whose variance is smooth."""
    return with_disparity_noise(view([wall(WALL_M)]).depth_m, SIGMA, np.random.default_rng(seed))


def split(depth_m, noise=None):
    """Return the pieces that the whole image, taken as one region, is cut into."""
    image = disparity_image(depth_m)
    noise = noise or estimate_noise(build_cell_grid(image), EXACT)
    model = cell_model(depth_m, noise)
    regions = one_patch(model)
    return split_at_depth_steps(frame_of(image, model, noise), regions,
                                Correlation.of(model, regions, noise))


@pytest.mark.parametrize(('frame', 'gap_m', 'least'), [
    ('wide', 0.06, 2), ('high', 0.08, 9)])
def test_a_picture_frame_is_a_plane_of_its_own(frame, gap_m, least):
    """At 6 cm, 1.4 deviations of the smooth part, 10 and 26 of 40; at 8 cm 30 and 39."""
    scene, hits = framed(frame, gap_m), 0
    for seed in range(10):
        noisy_m = with_disparity_noise(scene.depth_m, SIGMA, np.random.default_rng(seed))
        hits += best_iou(scene, segment_planes(noisy_m, VGA).labels).min() > 0.5
    assert hits >= least


def test_a_bare_wall_stays_one_plane():
    """Alone in all; in the whole in nine of ten, where a bulge may survive the merging."""
    assert [len(split(bare(seed)).coefficients) for seed in range(10)] == 10 * [1]
    counts = [len(segment_planes(bare(seed), VGA).planes) for seed in range(10)]
    assert counts.count(1) >= 9
    assert max(counts) <= 2
