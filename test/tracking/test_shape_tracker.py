# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Labels of shapes from image to image."""

from dataclasses import replace

import numpy as np

from plane_detector.config import Config, ShapesConfig
from plane_detector.shapes import detector
from plane_detector.tracking.shape_tracker import update_shape_tracks
from plane_detector.types import NO_PLANES, PlaneSegmentation, Shape, ShapeType

SHAPE = (60, 80)


def ball(x_m, radius_m=0.2, kind=ShapeType.SPHERE):
    return Shape(kind, np.array([x_m, 0.0, 2.0]), np.zeros(3), radius_m, 0.0, 0.0, 100, 0.001,
                 np.eye(4), 0.9)


def labels_at(*columns):
    labels = np.full(SHAPE, -1, np.int32)
    for k, column in enumerate(columns):
        labels[20:30, column:column + 10] = k
    return labels


def run(*images, keep_frames=5):
    tracks, names = (), []
    for shapes, labels in images:
        tracks, found = update_shape_tracks(tracks, shapes, labels, keep_frames)
        names.append(found)
    return names


def test_labels_follow_the_shapes_when_their_order_changes():
    names = run(((ball(0.0), ball(1.0)), labels_at(10, 50)),
                *(((ball(1.02), ball(0.02)), labels_at(51, 11)),) * 2)
    assert names == [(1, 2), (2, 1), (2, 1)]


def test_a_missed_shape_gets_its_label_back_and_others_do_not_take_it():
    names = run(((ball(0.0),), labels_at(10)), ((), labels_at()),
                ((ball(1.5),), labels_at(60)), ((ball(0.0), ball(1.5)), labels_at(10, 60)))
    assert names == [(1,), (), (2,), (1, 2)]


def test_another_type_or_a_size_that_changes_by_more_than_half_is_another_shape():
    for other, label in ((ball(0.0, kind=ShapeType.CYLINDER), 2), (ball(0.0, radius_m=0.5), 2),
                         (ball(0.0, radius_m=0.35), 1)):
        assert run(((ball(0.0),), labels_at(10)), ((other,), labels_at(10))) == [(1,), (label,)]


def test_the_detector_gives_each_shape_the_label_of_its_track(monkeypatch):
    found = iter((((ball(0.0), ball(1.0)), labels_at(10, 50)),
                  ((ball(1.02), ball(0.02)), labels_at(51, 11))))
    monkeypatch.setattr(detector, 'load_once', lambda *_: None)
    monkeypatch.setattr(detector, 'find_shapes', lambda *_: (None, *next(found)))
    finder, config = detector.ShapeDetector(), Config(shapes=ShapesConfig(types='all'))
    for expected in ([(0.0, 1), (1.0, 2)], [(1.02, 2), (0.02, 1)]):
        _, shapes, _ = finder.detect(None, None, None, None, config)
        assert [(shape.position_m[0], shape.label) for shape in shapes] == expected


def test_shapes_of_an_image_of_another_size_are_others(monkeypatch):
    """Their pixels are other ones; a label would be one by chance."""
    def found(size):
        labels = np.full(size, -1, np.int32)
        labels[20:30, 20:30] = 0
        planes = PlaneSegmentation(NO_PLANES, np.full(size, -1, np.int32), 0.001)
        monkeypatch.setattr(detector, 'find_shapes',
                            lambda *_: (planes, (ball(0.0),), labels))
        return [one.label for one in shapes.detect(
            np.ones(size, np.float32), planes, None, None,
            Config(shapes=ShapesConfig(types='all')))[1]]
    shapes = detector.ShapeDetector()
    assert found(SHAPE) == [1]
    shapes._tracks = tuple(replace(one, label=7) for one in shapes._tracks)
    assert found(SHAPE) == [7]
    assert found((120, 160)) == [1]
