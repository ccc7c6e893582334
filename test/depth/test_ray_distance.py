# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Distances along the rays are told from depth, and the other way round."""

import numpy as np
import pytest

from plane_detector import PlaneDetector
from plane_detector.config import Config, DepthConfig
from plane_detector.depth.ray_distance import kind_note
from plane_detector.evaluation.scenes.rooms import random_room
from plane_detector.geometry.projection import ray_lengths
from plane_detector.types import CameraIntrinsics

SIZES = [(640, 480), (320, 240), (160, 120), (640, 360), (480, 640)]
VIEWS = [(60.0, 0.0), (70.0, 0.002), (90.0, 0.004), (110.0, 0.004), (130.0, 0.001)]


def noisy(depth_m, share, rng):
    """Return depth with the noise of a sensor, k z^2."""
    return (depth_m + share * depth_m**2 * rng.normal(size=depth_m.shape)).astype(np.float32)


@pytest.mark.parametrize(('field_deg', 'share'), VIEWS)
@pytest.mark.parametrize('size', SIZES)
def test_rooms(size, field_deg, share):
    camera = CameraIntrinsics.from_field_of_view(*size, field_deg)
    rng = np.random.default_rng([*size, int(field_deg)])
    depth_m = random_room(rng, camera).depth_m
    z_m, ray_m = noisy(depth_m, share, rng), noisy(depth_m * ray_lengths(camera), share, rng)
    assert kind_note(z_m, camera, 'z') == ''
    assert 'set depth.kind to ray' in kind_note(ray_m, camera, 'z')
    assert kind_note(ray_m / ray_lengths(camera), camera, 'ray') == ''
    assert 'set depth.kind to z' in kind_note(z_m / ray_lengths(camera), camera, 'ray')


@pytest.mark.parametrize('depth_m', [
    np.full((240, 320), np.nan), np.random.default_rng(0).uniform(0.5, 8.0, (240, 320)),
    np.where(np.indices((240, 320)).sum(axis=0) % 40 < 20, 1.0, 3.0),
    np.full((4, 6), 2.0), np.full((240, 320), 2.0)])
def test_where_nothing_shows_the_kind_nothing_is_said(depth_m):
    """Nothing valid, noise, steps everywhere, hardly a pixel; a wall seen frontally is z."""
    camera = CameraIntrinsics.from_field_of_view(*depth_m.shape[::-1], 80.0)
    assert kind_note(depth_m.astype(np.float32), camera, 'z') == ''


@pytest.mark.parametrize('seed', range(6))
def test_round_and_uneven_things_are_not_taken_for_it(seed):
    """A ball farther away than its radius; a pipe along the view, and one with an end."""
    camera = CameraIntrinsics.from_field_of_view(320, 240, 70.0)
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[:240, :320]
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    radius_m, ahead_m = rng.uniform(0.5, 1.2), rng.uniform(3.0, 4.0)
    s2 = 1 + x * x + y * y
    with np.errstate(invalid='ignore'):
        ball_m = (ahead_m - np.sqrt(ahead_m**2 - s2 * (ahead_m**2 - radius_m**2))) / s2
    pipe_m = radius_m / np.sqrt(np.maximum(x * x + y * y, 1e-4))
    hall_m = np.minimum(pipe_m, 8.0)
    for depth_m in (ball_m, pipe_m, hall_m):
        assert kind_note(noisy(depth_m, 0.002, rng), camera, 'z') == ''


@pytest.mark.parametrize('kind', ['z', 'ray'])
def test_a_stream_says_it_until_its_settings_are_right(kind):
    camera = CameraIntrinsics.from_field_of_view(320, 240, 90.0)
    scene = random_room(np.random.default_rng(4), camera)
    given_m = scene.depth_m * (ray_lengths(camera) if kind == 'ray' else 1)
    for stated in ('z', 'ray'):
        detector = PlaneDetector(Config(depth=DepthConfig(source='topic', kind=stated)))
        for _ in range(3):
            found = detector.detect(scene.rgb, camera, given_m)
            remedy = '' if stated == kind else f'set depth.kind to {kind}'
            assert (remedy in found.input_note) and bool(found.input_note) == bool(remedy)
