# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Steps cut regions apart, noise, quantisation and holes do not."""

import pytest
from cell_helpers import (
    bare_wall,
    best_iou,
    cells_and_noise,
    disparity_image,
    frame_of,
    noisy,
    one_patch,
    rectangle,
    view,
    wall,
)

from plane_detector import segment_planes
from plane_detector.evaluation.scenes.rendering import VGA
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.regions.depth_steps import split_at_depth_steps

WALL_M = 2.5
FRAMES = {'wide': (-0.35, -0.25, 0.8, 0.6), 'high': (-0.3, -0.4, 0.6, 0.8)}


def split(depth_m):
    """Return the pieces that the whole image, taken as one region, is cut into."""
    model, noise = cells_and_noise(depth_m)
    regions = one_patch(model)
    return split_at_depth_steps(frame_of(disparity_image(depth_m), model, noise), regions,
                                Correlation.of(model, regions, noise))


@pytest.mark.parametrize(('frame', 'gap_m', 'least'), [
    ('wide', 0.06, 2), ('high', 0.08, 9)])
def test_a_picture_frame_is_a_plane_of_its_own(frame, gap_m, least):
    """At 6 cm, 1.4 deviations of the smooth part, 10 and 26 of 40; at 8 cm 30 and 39."""
    left, low, width, height = FRAMES[frame]
    scene = view([wall(WALL_M), rectangle([left, WALL_M - gap_m, low], [width, 0, 0],
                                          [0, 0, height])])
    assert sum(best_iou(scene, segment_planes(noisy(scene, seed), VGA).labels).min() > 0.5
               for seed in range(10)) >= least


def test_a_bare_wall_stays_one_plane():
    """Alone in all; in the whole in nine of ten, where a bulge may survive the merging."""
    walls = [noisy(bare_wall(), seed) for seed in range(10)]
    assert [len(split(depth_m).coefficients) for depth_m in walls] == 10 * [1]
    counts = [len(segment_planes(depth_m, VGA).planes) for depth_m in walls]
    assert counts.count(1) >= 9 and max(counts) <= 2
