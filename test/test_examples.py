# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The examples in docstrings give the stated results."""

from importlib import import_module

import pytest
from examples import failures_in, modules_with_examples

# What others call from their own code has an example.
PUBLIC = {
    'plane_detector': (),
    'plane_detector.depth.observation': ('DepthFunction',),
    'plane_detector.config': ('Config',),
    'plane_detector.drawing': ('colour_depth', 'figure', 'label_colours', 'overlay',
                               'plane_colours'),
    'plane_detector.geometry.disparity': ('to_depth', 'to_disparity', 'valid_depth'),
    'plane_detector.geometry.gravity': ('measured_direction', 'unit_direction'),
    'plane_detector.geometry.projection': ('depth_to_points', 'pixel_rays'),
    'plane_detector.geometry.rigid_transform': ('RigidTransform',),
    'plane_detector.geometry.robust': ('dilated', 'median'),
    'plane_detector.pipeline': ('PlaneDetector', 'segment_planes'),
    'plane_detector.planes.classification': ('classify_planes',),
    'plane_detector.planes.outline': ('PlacedDetection', 'all_polygons'),
    'plane_detector.scale.methods': ('estimate_scale',),
    'plane_detector.settings': ('setting',),
    'plane_detector.stage_timer': ('StageTimer',),
    'plane_detector.tracking.tracker': ('PlaneTracker',),
    'plane_detector.types': ('CameraIntrinsics', 'Plane', 'Planes'),
}


@pytest.mark.parametrize('name', modules_with_examples(needs_ros=False))
def test_examples_give_the_stated_results(name):
    assert failures_in(name) == 0


@pytest.mark.parametrize('name', PUBLIC)
def test_public_functions_have_an_example(name):
    module = import_module(name)
    for thing in [getattr(module, member) for member in PUBLIC[name]] or [module]:
        assert '>>> ' in thing.__doc__, f'{name}: {thing}'
