# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Edges and lines of an image that are none of its depth do not make a good depth worse."""

import numpy as np
import pytest

from plane_detector import Config, PlaneDetector
from plane_detector.config import DirectionsConfig, SegmentationConfig
from plane_detector.depth.observation import DepthFunction
from plane_detector.evaluation.metrics import overlap, pure_errors, segmentation_covering
from plane_detector.evaluation.peers import plane_array
from plane_detector.evaluation.scenes import rooms
from plane_detector.evaluation.scenes.misleading import KINDS, misleading_image
from plane_detector.evaluation.scenes.noise import with_disparity_noise


def room(seed, kind):
    scene = rooms.random_room(np.random.default_rng(seed))
    return scene, misleading_image(scene, kind, np.random.default_rng([seed, 3]))


def errors(scene, detection, mask):
    """Return the covering, and the angles of planes to the true ones, in degrees."""
    shared = overlap(scene.labels, detection.labels, mask)
    return (segmentation_covering(shared.counts),
            pure_errors(shared, scene.planes, plane_array(detection))[0])


@pytest.mark.parametrize('kind', KINDS)
def test_exact_depth_of_a_function_stays_exact(kind):
    scene, rgb = room(302, kind)  # in which images turned planes by 20 to 65 degrees
    detector = PlaneDetector(depth_model=DepthFunction(lambda rgb: scene.depth_m, blur_px=3))
    covering, errors_deg = errors(scene, detector.detect(rgb, scene.intrinsics),
                                  np.isfinite(scene.depth_m))
    assert covering > 0.99
    assert errors_deg.max() < 0.5


@pytest.mark.parametrize(('make', 'seed'), [
    (rooms.random_room, 303), (rooms.random_room, 305), (rooms.hexagon_room, 304)])
def test_exact_depth_stays_exact_whatever_noise_the_network_states(make, seed):
    scene = make(np.random.default_rng(seed))  # in which stripes turned planes by 2 to 4 degrees
    rgb = misleading_image(scene, 'stripes', np.random.default_rng([seed, 3]))
    model = DepthFunction(lambda rgb: scene.depth_m, noise_share=0.006, blur_px=3)
    detection = PlaneDetector(depth_model=model).detect(rgb, scene.intrinsics)
    assert errors(scene, detection, np.isfinite(scene.depth_m))[1].max() < 0.5


def without_and_with(make, seed, kind):
    """Return the errors under slight noise with a setting off and on."""
    scene, rgb = room(seed, kind)
    depth_m = with_disparity_noise(scene.depth_m, 0.002, np.random.default_rng([seed, 2]))
    for is_on in (False, True):
        detector = PlaneDetector(make(is_on), DepthFunction(lambda rgb: depth_m, blur_px=3))
        yield errors(scene, detector.detect(rgb, scene.intrinsics), np.isfinite(scene.depth_m))


@pytest.mark.parametrize(('seed', 'kind'), zip((301, 303, 301, 303), KINDS, strict=True))
def test_planes_of_good_depth_are_not_turned_to_axes_of_the_picture(seed, kind):
    (_, without_deg), (_, turned_deg) = without_and_with(
        lambda turns: Config(directions=DirectionsConfig(orient_planes=turns)), seed, kind)
    assert turned_deg.mean() < without_deg.mean() + 0.02


@pytest.mark.parametrize(('seed', 'kind'), zip((300, 301, 300, 301), KINDS, strict=True))
def test_borders_of_good_depth_do_not_move_to_edges_of_the_picture(seed, kind):
    (without, _), (snapped, _) = without_and_with(
        lambda snaps: Config(segmentation=SegmentationConfig(snap_to_picture=snaps)), seed, kind)
    assert snapped > without - 0.003
