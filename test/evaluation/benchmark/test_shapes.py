# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The benchmark of shapes: what is found is matched with the truth."""

import numpy as np
import pytest

from plane_detector.evaluation.benchmark import shapes
from plane_detector.evaluation.benchmark.shapes import ShapeGuess
from plane_detector.evaluation.scenes.shapes import ShapeScene, TrueShape
from plane_detector.types import ShapeType

UP = np.array([0.0, 1.0, 0.0])


def mask_of(rows):
    mask = np.zeros((100, 100), bool)
    mask[rows] = True
    return mask


def truth(kind, rows, radius=0.2, axis=UP):
    return TrueShape(kind, np.zeros(3), axis, radius, 0.0, mask_of(rows))


def guess(kind, rows, radius=0.2, axis=UP):
    return ShapeGuess(kind, mask_of(rows), radius, axis)


def test_matches_need_the_type_and_half_of_the_pixels():
    scene = ShapeScene(None, (truth(ShapeType.CYLINDER, np.s_[:20]),
                              truth(ShapeType.SPHERE, np.s_[40:60], axis=np.zeros(3)),
                              truth(ShapeType.CONE, np.s_[80:85])), '')
    tilted = np.array([0.0, np.cos(0.1), np.sin(0.1)])
    judged = shapes.match(scene, [guess(ShapeType.CYLINDER, np.s_[:18], 0.22, -tilted),
                                  guess(ShapeType.CONE, np.s_[40:60]),
                                  guess(ShapeType.CYLINDER, np.s_[0:20])])
    assert judged.matched == (ShapeType.CYLINDER,)
    assert judged.missed == (ShapeType.SPHERE,)  # the cone is too small to be missed
    assert judged.wrong == 2
    assert judged.radius_errors == pytest.approx((0.1,))
    assert judged.axis_errors_deg == pytest.approx((np.degrees(0.1),))
