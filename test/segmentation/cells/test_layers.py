# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Meshes and gratings: the near layer is the plane, and what mixes it with the far one is said."""

import numpy as np
import pytest

from plane_detector.evaluation.scenes.sensor_cases import mesh
from plane_detector.pipeline import segment_planes
from plane_detector.segmentation.cells.grid import DisparityImage, build_cell_grid
from plane_detector.segmentation.cells.layers import without_far_layer
from plane_detector.segmentation.cells.noise import Noise

FLOOR = Noise(0.0005)
V, U = np.mgrid[:480, :640]
FAR = 0.5 + 0.0002 * U


def near_layer(disparity, noise=0.001):
    """Return the image without what is seen through a mesh, its grid, and the image as given."""
    rng = np.random.default_rng(0)
    noisy = (disparity + noise * rng.standard_normal(disparity.shape)).astype(np.float32)
    image = DisparityImage(noisy, noisy > 0)
    return *without_far_layer(image, build_cell_grid(image), FLOOR), image


@pytest.mark.parametrize('is_solid', [
    U % 3 > 0, (U % 4 > 0) & (V % 4 > 0), V % 13 < 9, (U + V) % 5 > 1,
    np.random.default_rng(1).random(U.shape) < 0.6])
def test_pixels_behind_a_mesh_are_left_out(is_solid):
    """Of a mesh that fills the image, and so sets all that the image shows as noise."""
    found, grid, _ = near_layer(np.where(is_solid, FAR + 0.2, FAR))
    assert (found.valid == is_solid).mean() > 0.98
    assert grid.is_mesh.mean() > 0.75


def poles(width_px):
    """Return two poles, a cable and a board before a wall."""
    is_near = (abs(U - 200) < width_px) | (abs(V - 100 - U // 3) < width_px / 2) | (
        (abs(U - 450) < 60) & (abs(V - 300) < 90)) | (abs(U - 3 * V) < width_px)
    return np.where(is_near, FAR + 0.3, FAR)


@pytest.mark.parametrize('disparity', [
    FAR, poles(2), poles(6), np.where(V > 2 * U / 3, FAR + 0.3, FAR), np.rint(FAR * 100) / 100,
    0.5 + 0.1 * np.hypot(U - 320, V - 240) / 240], ids=[
    'wall', 'thin poles', 'poles', 'edge', 'steps', 'cone'])
@pytest.mark.parametrize('noise', [0.0005, 0.004, 0.03])
def test_edges_poles_steps_and_noise_are_no_mesh(disparity, noise):
    found, _, image = near_layer(disparity, noise)
    assert found is image


def test_a_wall_that_is_one_of_two_steps_of_the_sensor_by_chance_is_no_mesh():
    """Seen from the front, in steps of a pixel of disparity."""
    rng = np.random.default_rng(0)
    values = np.where(rng.random(U.shape) < 0.4, 0.38, 0.40).astype(np.float32)
    image = DisparityImage(values, values > 0)
    grid = build_cell_grid(image)
    assert without_far_layer(image, grid, Noise(0.0005, 0.02 / 12**0.5))[0] is image


def of_mesh(seed):
    """Return the share of a mesh in one plane, how far that is off it, and the stated error."""
    scene, depth_m = mesh(np.random.default_rng(seed))
    surface = int(np.flatnonzero(scene.rectangles == 1)[0])
    found, on = segment_planes(depth_m, scene.intrinsics), scene.labels == surface
    counts = np.bincount(found.labels[on] + 1, minlength=2)[1:]
    plane, truth = found.planes[int(counts.argmax())], scene.planes[surface]
    here = np.append(plane.centroid_m, 1.0)
    return counts.max() / on.sum(), abs(truth @ here), (here @ plane.covariance @ here) ** 0.5


@pytest.mark.parametrize('seed', [9000, 9004, 9007, 9013, 9016, 9021, 9022, 9023])
def test_a_mesh_is_one_plane_with_an_honest_error(seed):
    """Mesh and bars, stereo and time of flight, sharp and mixed; of the mean, both 2 to 40 cm."""
    share, off_m, sigma_m = of_mesh(seed)
    assert share > 0.85
    assert off_m < 3 * sigma_m
    assert sigma_m < 0.02
