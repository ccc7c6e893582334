# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Planes as a sequence that is indexed as an array."""

from dataclasses import fields

import numpy as np
import pytest

from plane_detector.types import NO_PLANES, Plane, Planes

MANY = Planes.of([Plane(np.eye(3)[k % 3], float(k), np.full(3, k), k + 1, k / 7, k / 3,
                        k * np.eye(4), k / 5, k / 6, label=k + 2, merged=k) for k in range(5)])


@pytest.mark.parametrize('index', [
    slice(2), slice(None, None, -2), slice(1, 1), slice(-2, None), [0, 3, 3], [], (4, -1),
    np.array([2, 0], np.uint8), np.arange(5) > 2, [True, False, True, False, True],
    np.zeros(5, bool), range(1, 3)])
def test_some_planes_are_planes_with_all_their_columns(index):
    some = MANY[index]
    where = np.arange(5)[index if isinstance(index, slice) else np.array(
        index, None if len(index) else int)]
    assert isinstance(some, Planes) and len(some) == len(where)
    for column in fields(Planes):
        np.testing.assert_array_equal(getattr(some, column.name),
                                      getattr(MANY, column.name)[where])
    assert [plane.label for plane in some] == [MANY[int(k)].label for k in where]


@pytest.mark.parametrize('index', [3, -2, np.int64(3), np.uint8(3), np.array(3)])
def test_one_plane_is_a_plane(index):
    assert isinstance(MANY[index], Plane) and MANY[index].offset_m == 3.0


@pytest.mark.parametrize('index', [5, -6, [0, 5], np.ones(4, bool), np.zeros((1, 1), int),
                                   np.array([0.0, 1.0])])
def test_what_is_not_there_is_an_index_error(index):
    with pytest.raises(IndexError):
        MANY[index]


@pytest.mark.parametrize('index', [1.0, 'a', None])
def test_what_is_no_index_is_a_type_error(index):
    with pytest.raises(TypeError):
        MANY[index]


def test_none_of_none():
    assert len(NO_PLANES[:3]) == len(NO_PLANES[[]]) == len(NO_PLANES[np.zeros(0, bool)]) == 0
