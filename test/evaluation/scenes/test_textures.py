# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Rendered scenes with lines."""

import numpy as np

from plane_detector.evaluation.scenes.rooms import attic
from plane_detector.evaluation.scenes.textures import textured
from plane_detector.types import CameraIntrinsics

SMALL = CameraIntrinsics.from_field_of_view(80, 60, 60.0)


def test_the_floor_has_planks_where_no_upright_plane_is_seen():
    with np.errstate(invalid='raise'):
        scene = textured(attic, 15, SMALL)
    along_gravity = np.abs(scene.planes[:, :3] @ scene.gravity_camera)
    assert along_gravity.min() > 0.05, 'no plane is upright'
    floor = scene.labels == along_gravity.argmax()
    assert floor.any()
    assert scene.rgb[floor].std() > 5
