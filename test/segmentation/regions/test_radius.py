# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""How far a single region must turn to be curved goes with its smallest radius."""

import numpy as np
import pytest
from cell_helpers import EXACT, disparity_image

from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.segmentation.cells.grid import build_cell_grid, lens_of
from plane_detector.segmentation.cells.model import fit_regions, weigh_cells
from plane_detector.segmentation.cells.noise import estimate_noise
from plane_detector.segmentation.regions.curved import find_curved
from plane_detector.segmentation.regions.region_graph import RegionGraph
from plane_detector.types import CameraIntrinsics

DISTANCE_M, LEAST_DEG, MOST_RADIUS_M = 0.8, 2.0, 1.5


def is_curved(radius_m, turn_deg, is_turned):
    """Return whether a column that fills the image is curved, of which so much is seen."""
    v, u = np.mgrid[-239.5:240, -319.5:320]
    half_m = radius_m * np.sin(np.radians(turn_deg / 2))
    across_px, focal_px = (v, 239.5) if is_turned else (u, 319.5)
    focal_px *= DISTANCE_M / half_m
    slope = across_px / focal_px
    # The ray meets the circle about a middle behind the front.
    middle_m = DISTANCE_M + radius_m
    a, b, c = 1 + slope**2, -2 * middle_m, middle_m**2 - radius_m**2
    depth_m = ((-b - np.sqrt(b * b - 4 * a * c)) / (2 * a)).astype(np.float32)
    noisy_m = with_disparity_noise(depth_m, 0.002, np.random.default_rng(0))
    camera = CameraIntrinsics(focal_px, focal_px, 319.5, 239.5, 640, 480)
    grid = build_cell_grid(disparity_image(noisy_m), lens=lens_of(camera))
    noise = estimate_noise(grid, EXACT)
    cells = weigh_cells(grid, noise)
    graph = RegionGraph.of(cells, fit_regions(cells, np.zeros(cells.grid.shape, np.int32), 1))
    return bool(find_curved(graph, noise.density, LEAST_DEG, noise.bending,
                            MOST_RADIUS_M).size)


@pytest.mark.parametrize('is_turned', [False, True])
@pytest.mark.parametrize('radius_m', [3.0, 4.5])
def test_a_column_is_curved_by_its_own_radius_though_it_is_straight_along_its_axis(
        radius_m, is_turned):
    needed_deg = LEAST_DEG * radius_m / MOST_RADIUS_M
    assert is_curved(radius_m, 1.4 * needed_deg, is_turned)
    assert not is_curved(radius_m, 0.7 * needed_deg, is_turned)
