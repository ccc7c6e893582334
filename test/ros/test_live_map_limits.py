# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The map of a node without the node: clicks, what it says of the poses, labels after a load."""

import numpy as np
import pytest
from map_helpers import map_plane
from ros_helpers import header

from plane_detector.config import MapConfig
from plane_detector.geometry.rigid_transform import RigidTransform
from plane_detector.mapping.plane_map import MapUpdate
from plane_detector.mapping.registration import Correction
from plane_detector.ros.live_map import LiveMap
from plane_detector.types import PlaneClass


@pytest.fixture
def live():
    """Return a map of the floor, 1 m x 1 m from the origin on, and an image in it."""
    live = LiveMap(MapConfig(cell=0.05), 'odom')
    live._map.planes = (map_plane(7, PlaneClass.FLOOR, (0, 0, 0), np.eye(3),
                                  np.full((20, 20), 5)),)
    live._header, live._update = header(1.0), MapUpdate(np.zeros(0, int), 1.0)
    return live


def test_a_click_is_answered_within_ten_centimetres_of_a_plane(live):
    for point_m in ([0.5, 0.5, 0.09], [1.05, 0.5, 0.0]):
        assert live.plane_at(np.array(point_m))[1].label == 7
    for point_m in ([0.5, 0.5, 0.13], [1.13, 0.5, 0.0], [0.5, -2.0, 0.0]):
        with pytest.raises(ValueError, match='nor is there one in the map'):
            live.plane_at(np.array(point_m))


@pytest.mark.parametrize('moved_m, is_said', [(0.19, False), (0.21, True)])
def test_a_correction_above_twenty_centimetres_raises_doubts(live, moved_m, is_said):
    shifted = RigidTransform(np.eye(3), np.array([moved_m, 0.0, 0.0]))
    live._map.correction = Correction(shifted, np.eye(6), shifted, np.eye(6),
                                      RigidTransform.identity())
    assert ('the map corrects the poses by 21 cm' in live.problem()) == is_said


@pytest.mark.parametrize('jitter_m, is_said', [(0.009, False), (0.011, True)])
def test_jitter_above_twice_the_setting_is_said_with_the_value_to_set(live, jitter_m, is_said):
    live._map.jitter_m = jitter_m
    assert ('map.pose_jitter is 0.5 cm: set it to 0.011' in live.problem()) == is_said


def test_a_map_is_given_out_once_for_each_change(live, tmp_path):
    assert live.take_view() is None
    live.save(tmp_path / 'map.json')
    live.load(tmp_path / 'map.json')
    assert [plane.label for plane in live.take_view().snapshot.surfaces] == [7]
    assert live.take_view() is None
    assert live.clear() == '1 planes were removed'
    assert live.take_view().snapshot.surfaces == ()


def test_what_no_message_can_be_made_of_leaves_the_map(live, tmp_path, monkeypatch):
    live.save(tmp_path / 'map.json')
    before = live._map

    def fail(_view):
        raise OverflowError('too large for the message')
    monkeypatch.setattr('plane_detector.ros.live_map.make_map_messages', fail)
    with pytest.raises(OverflowError):
        live.load(tmp_path / 'map.json')
    assert live._map is before and before.planes[0].label == 7
