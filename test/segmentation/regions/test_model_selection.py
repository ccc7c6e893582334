# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Steps and creases within the noise keep regions apart, the noise's own borders do not."""

import numpy as np
import pytest
from cell_helpers import (
    bare_wall,
    best_iou,
    cells_and_noise,
    disparity_image,
    fold,
    frame_of,
    noisy,
    one_patch,
    rectangle,
    regions_of_labels,
    view,
    wall,
)

from plane_detector import segment_planes
from plane_detector.evaluation.scenes.rendering import VGA
from plane_detector.segmentation.cells.model import MEAN_WEIGHT
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.regions import model_selection as seams
from plane_detector.segmentation.regions.model_selection import (
    _with_piece,
    prefer_two_planes,
    split_at_depth_steps,
)

SEEDS = range(12)
WALL_M = 2.5
LEFT, MIDDLE = np.zeros((60, 80), int), np.zeros((60, 80), int)
LEFT[:, 40:], MIDDLE[20:40, 30:50] = 1, 1


def two(depth_m, labels):
    """Say whether the two regions of these labels are kept apart."""
    model, noise = cells_and_noise(depth_m)
    regions = regions_of_labels(model, labels)
    correlation = Correlation.of(model, regions, noise)
    return prefer_two_planes(model, regions.labels, correlation, 0, 1)


@pytest.mark.parametrize(('gap_m', 'least'), [(0.06, 9), (0.08, 12), (0.12, 12)])
def test_a_step_of_about_the_noise_is_seen(gap_m, least):
    """1.4 to 3 deviations of the smooth part; the border of the region is the frame's."""
    frame = rectangle([-0.35, WALL_M - gap_m, -0.25], [0.8, 0, 0], [0, 0, 0.6])
    scene = view([wall(WALL_M), frame])
    labels = (scene.labels[4::8, 4::8] == scene.labels[240, 320]).astype(int)
    assert sum(two(noisy(scene, seed), labels) for seed in SEEDS) >= least


def test_a_crease_is_seen():
    """Two walls that meet at 140 degrees."""
    scene = view(fold(40))
    labels = scene.labels[4::8, 4::8]
    assert set(np.unique(labels)) >= {0, 1}
    assert all(two(noisy(scene, seed, 0.001), labels) for seed in SEEDS)


@pytest.mark.parametrize('labels', [LEFT, MIDDLE], ids=['halves', 'box'])
def test_a_border_drawn_on_a_wall_is_none(labels):
    assert not any(two(noisy(bare_wall(), seed), labels) for seed in SEEDS)


def test_the_gain_is_that_of_the_likelihood():
    """Twice the logarithm of the ratio of two normal densities, one by one."""
    model, noise = cells_and_noise(noisy(view([wall(WALL_M), wall(WALL_M - 0.08, 0, 0.7)]), 3))
    labels = np.zeros((60, 80), int)
    labels[:, 40:52] = 1
    regions = regions_of_labels(model, labels)
    correlation = Correlation.of(model, regions, noise)
    # Some cells vary more than the others, as steep ones do.
    model.table[:, MEAN_WEIGHT] /= np.random.default_rng(0).uniform(1, 3, len(model.table))
    extra = 1 / model.table[:, MEAN_WEIGHT] - model.least_variance
    cell, small = seams._cells_about(regions.labels, model.is_planar, (0, 1))
    assert len(cell) > seams.NEAREST_CELLS

    def gain(count):
        x, y, d = model.grid.mean[cell[:count]].T
        one = np.stack([np.ones_like(x), x, y], axis=1)
        both = np.hstack([one, one * small[:count, None]])
        row, column = np.divmod(cell[:count], 80)
        covariance = correlation.table[abs(row[:, None] - row), abs(column[:, None] - column)]
        root = np.linalg.cholesky(covariance + np.diag(extra[cell[:count]]))

        def error(design):
            design, values = np.linalg.solve(root, design), np.linalg.solve(root, d)
            residual = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
            return residual @ residual

        return error(one) - error(both)

    for enough, count in ((np.inf, len(cell)), (1.0, seams.NEAREST_CELLS)):
        assert gain(count) > 10
        found = seams.log_likelihood_gain(regions.labels, model.table, model.is_planar,
                                          correlation.table, (0, 1),
                                          (enough, model.least_variance))
        assert found == pytest.approx(gain(count), rel=1e-3), 'in single precision'


FRAMES = {'wide': (-0.35, -0.25, 0.8, 0.6), 'high': (-0.3, -0.4, 0.6, 0.8)}


def split(depth_m):
    """Return the pieces that the whole image, taken as one region, is cut into."""
    model, noise = cells_and_noise(depth_m)
    regions = one_patch(model)
    return split_at_depth_steps(frame_of(disparity_image(depth_m), model, noise), regions,
                                Correlation.of(model, regions, noise))


def test_a_piece_gets_the_cells_that_it_and_half_the_step_around_it_fill_by_half():
    """Blocks 4 to 7 down and 8 across, with 2 around: a half to a whole cell of two cells."""
    runs = np.array([[row, 8, 9, 0] for row in range(4, 8)], np.int32)
    labels = np.zeros((4, 6), np.int32)
    labels[1, 3] = 5
    expected = labels.copy()
    expected[1, 1:3] = 7
    np.testing.assert_array_equal(_with_piece(labels, runs, 0, (0, 7)), expected)


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
