# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""From planes to depth and from labelled depth to planes."""

import numpy as np

from plane_detector.evaluation.plane_geometry import fit_planes, plane_depth
from plane_detector.evaluation.scenes.rooms import random_room
from plane_detector.types import CameraIntrinsics

SMALL = CameraIntrinsics(131.0, 131.0, 79.5, 59.5, 160, 120)


def test_the_depth_of_a_plane_is_where_the_rays_meet_it():
    scene = random_room(np.random.default_rng(2), SMALL)
    np.testing.assert_allclose(plane_depth(scene.labels, scene.planes, SMALL), scene.depth_m,
                               rtol=1e-4)
    nothing = np.full((120, 160), -1)
    assert np.isnan(plane_depth(nothing, scene.planes[:0], SMALL)).all()


def test_planes_are_fitted_to_their_pixels():
    scene = random_room(np.random.default_rng(2), SMALL)
    np.testing.assert_allclose(fit_planes(scene.labels, scene.depth_m, SMALL), scene.planes,
                               atol=2e-3)
