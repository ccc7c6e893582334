# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The benchmark of shapes: what is found is matched with the truth."""

import numpy as np

from plane_detector.evaluation.benchmark import shapes
from plane_detector.evaluation.scenes.shapes import SeenShape, ShapeScene
from plane_detector.types import ShapeType


def seen(kind, rows, radius=0.2, axis=(0.0, 1.0, 0.0)):
    mask = np.zeros((100, 100), bool)
    mask[rows] = True
    return SeenShape(kind, np.zeros(3), np.array(axis), radius, 0.0, mask)


def test_matches_need_the_type_and_half_of_the_pixels():
    column, ball, small = true = (
        seen(ShapeType.CYLINDER, np.s_[:20]), seen(ShapeType.SPHERE, np.s_[40:60], axis=(0, 0, 0)),
        seen(ShapeType.CONE, np.s_[80:85]))
    found = [seen(ShapeType.CYLINDER, np.s_[:18], 0.22), seen(ShapeType.CONE, np.s_[40:60]),
             seen(ShapeType.CYLINDER, np.s_[0:20])]
    ((shape, matched),), (missed,), wrong = shapes.match(ShapeScene(None, true, ''), found)
    assert shape is found[0] and matched is column
    assert missed is ball, 'the cone is too small to be missed'
    assert wrong == 2


def test_errors_of_radius_and_axis_are_of_matched_shapes(monkeypatch):
    tilted = (0.0, -np.cos(0.1), np.sin(0.1))
    true, found = (seen(ShapeType.CYLINDER, np.s_[:20]),), [
        seen(ShapeType.CYLINDER, np.s_[:20], 0.22, tilted)]
    monkeypatch.setattr(shapes, 'shape_scene', lambda rng: ShapeScene(None, true, ''))
    monkeypatch.setattr(shapes, 'noisy_depth', lambda *scene: None)
    monkeypatch.setattr(shapes, 'found_shapes', lambda *scene: found)
    assert shapes._row([0, 1], 0.004) == [
        '0.004', '2', '2', '1.00', '0 of 0', '2 of 2', '0 of 0', '1.00', '10.0 / 10.0 %',
        '5.7 / 5.7 deg']
