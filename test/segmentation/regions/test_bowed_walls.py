# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What a network bows is joined to one wall, real folds and measured depth are not."""

import numpy as np
import pytest
from cell_helpers import cell_model, fold, hand_made, view, wall

from plane_detector import segment_planes
from plane_detector.config import Config
from plane_detector.evaluation.scenes.rendering import VGA
from plane_detector.segmentation.cells.model import PlaneRegions
from plane_detector.segmentation.cells.noise import Noise
from plane_detector.segmentation.regions import merging
from plane_detector.segmentation.regions.region_graph import RegionGraph

KNOWN = 0.008
NETWORK = Noise(Config().ransac.noise_floor, source_sigma=KNOWN, mean_sigma=KNOWN,
                slope_sigma=8 * KNOWN, pixel_sigma=KNOWN / 4)


def bowed(depth_m, height):
    """Return depth whose disparity rises to the sides by so much per metre."""
    x = np.linspace(-1, 1, depth_m.shape[1])
    return (1 / (1 / depth_m + height * x * x)).astype(np.float32)


def halves(depth_m, noise=NETWORK):
    """Return model and regions of the left and the right half of an image."""
    model = cell_model(depth_m, noise)
    labels = np.zeros(model.grid.shape, int)
    labels[:, labels.shape[1] // 2:] = 1
    return model, hand_made(model, labels)


def merge_bowed_walls(model, regions):
    merged = merging.merge_bowed_walls(RegionGraph.of(model, regions))
    return PlaneRegions(merged.labels, merged.planes)


def test_the_halves_of_a_bowed_wall_are_one():
    model, regions = halves(bowed(view([wall(2)]).depth_m, 0.06))
    joined = merge_bowed_walls(model, regions)
    assert joined.coefficients.shape == (1, 3)
    assert (joined.labels == 0).all()


@pytest.mark.parametrize('angle_deg', [40, 90])
def test_planes_that_meet_in_a_fold_stay_two(angle_deg):
    scene = view(fold(angle_deg, width_m=5))
    assert len(merge_bowed_walls(*halves(scene.depth_m)).coefficients) == 2


def test_a_sharp_bend_and_a_step_stay_two():
    assert len(merge_bowed_walls(*halves(bowed(view([wall(2)]).depth_m, 0.5))).coefficients) == 2
    step = view([wall(2), wall(1.8, 0, 50)])
    assert len(merge_bowed_walls(*halves(step.depth_m)).coefficients) == 2


@pytest.mark.parametrize('height', [0.06, 0.09])
@pytest.mark.parametrize('angles_deg', [(0, 0, 0), (30, 0, 0), (0, -50, 0)])
def test_a_bowed_wall_is_one_plane(angles_deg, height):
    depth_m = bowed(view([wall(2)], angles_deg=angles_deg).depth_m, height)
    found = segment_planes(depth_m, VGA, disparity_noise=KNOWN)
    assert len(found.planes) == 1
    assert (found.labels == 0).mean() > 0.97
