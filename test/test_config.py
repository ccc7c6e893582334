# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Invalid settings are refused when they are created."""

import pytest

from plane_detector.config import DepthConfig, ScaleConfig


@pytest.mark.parametrize(('changes', 'said'), [
    ({'mean': (0.5,)}, 'mean must be 3 numbers'), ({'std': (1.0, 1.0)}, 'std must be 3 numbers'),
    ({'input_width': 64}, 'must be given together'), ({'providers': ()}, 'at least one')])
def test_impossible_settings_are_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        DepthConfig(**changes)


@pytest.mark.parametrize('settings', [{'gravity': (0.0, 1.0)}, {'imu_to_camera': (0.0,) * 4},
                                      {'method': 'guess'}, {'camera_height': -1.0}])
def test_meaningless_settings_are_refused(settings):
    with pytest.raises(ValueError, match=next(iter(settings))):
        ScaleConfig(**settings)
