# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The weight of a network's normals in the orientation of planes depends on their noise."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from plane_detector.config import Config
from plane_detector.depth.observation import DepthFunction
from plane_detector.evaluation.metrics import angle_deg
from plane_detector.geometry.projection import pixel_rays
from plane_detector.pipeline import PlaneDetector
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(300.0, 300.0, 159.5, 119.5, 320, 240)


def towards(azimuth_deg):
    """Return the normal of an upright wall that looks at the camera."""
    angle = np.radians(azimuth_deg)
    return np.array([np.sin(angle), 0.0, -np.cos(angle)])


def wall_m(azimuth_deg, offset_m=2.5):
    normal, (x, y) = towards(azimuth_deg), pixel_rays(CAMERA)
    return offset_m / -(normal[0] * x[None] + normal[1] * y[:, None] + normal[2])


def normal_map(azimuth_deg, noise_deg=2.0, shape=(240, 320)):
    rng = np.random.default_rng(0)
    normals = towards(azimuth_deg) + np.radians(noise_deg) * rng.standard_normal((*shape, 3))
    return (normals / np.linalg.norm(normals, axis=-1, keepdims=True)).astype(np.float32)


def bowed(depth_m, amount):
    """Return depth whose 1/z waves, as that of a network that is unsure."""
    x, y = np.meshgrid(np.arange(320), np.arange(240))
    return 1 / (1 / depth_m + amount * np.sin(x / 9) * np.sin(y / 7))


@dataclass(frozen=True)
class Network(DepthFunction):
    """A network of known depth and normals."""

    normals_camera: np.ndarray | None = None

    def predict(self, rgb, intrinsics):
        return replace(super().predict(rgb, intrinsics), normals_camera=self.normals_camera)


def found_normal(depth_m, normals_camera):
    detector = PlaneDetector(Config(), Network(
        lambda rgb: depth_m.astype(np.float32), noise_share=0.02, normals_camera=normals_camera))
    planes = detector.detect(np.zeros((240, 320, 3), np.uint8), CAMERA).planes
    assert len(planes) == 1
    return planes[0]


def error_deg(plane, azimuth_deg):
    return angle_deg(plane.normal, towards(azimuth_deg))


def test_accurate_normals_rotate_a_plane_of_inaccurate_depth():
    depth_m = bowed(wall_m(20), 0.012)
    assert error_deg(found_normal(depth_m, None), 10) == pytest.approx(10, abs=2)
    turned = found_normal(depth_m, normal_map(10))
    assert error_deg(turned, 10) < 2
    z_m = np.median(depth_m)
    assert abs(turned.centroid_m[2] - z_m) < 0.05 * z_m, 'it stays where it is'


def test_inaccurate_normals_do_not_rotate_a_plane_of_accurate_depth():
    assert error_deg(found_normal(wall_m(20), normal_map(0, noise_deg=25.0)), 20) < 2


def test_equal_noise_meets_in_the_middle():
    assert error_deg(found_normal(wall_m(20), normal_map(10, noise_deg=0.0)), 15) < 0.5
