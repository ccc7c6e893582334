# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Measurements of planes, compared with their pixels."""

from dataclasses import replace

import numpy as np
import pytest

from plane_detector import CameraIntrinsics
from plane_detector.planes.measurement import (
    CONFIDENCE_WEIGHTS,
    SUMS,
    missing_planes_note,
    planes_from_sums,
    ray_plane_jacobian,
)
from plane_detector.segmentation.cells.grid import DisparityImage, build_cell_grid
from plane_detector.segmentation.cells.model import PixelRegions, count_labels, relabel_sequential
from plane_detector.segmentation.cells.noise import Noise


def counted(labels, size, count):
    """Return the pixels of each label in each cell, by a loop."""
    return np.array([
        [np.count_nonzero(labels[row:row + size, column:column + size] == k)
         for k in range(count)]
        for row in range(0, labels.shape[0], size) for column in range(0, labels.shape[1], size)])


@pytest.mark.parametrize(('shape', 'size'), [
    ((37, 53), 4), ((37, 53), 3), ((36, 52), 4), ((5, 3), 4), ((1, 1), 4), ((8, 8), 8),
    ((23, 40), 1)])
@pytest.mark.parametrize('count', [1, 5])
@pytest.mark.parametrize('patchy', [False, True])
def test_labels_are_counted_as_in_a_loop(shape, size, count, patchy):
    rng = np.random.default_rng(count)
    labels = rng.integers(-1, count, shape).astype(np.int32)
    if patchy:  # most cells have one label
        labels = labels[::5, ::5].repeat(5, axis=0).repeat(5, axis=1)[:shape[0], :shape[1]]
    grid = build_cell_grid(DisparityImage(np.ones(shape, np.float32), np.ones(shape, bool)), size)
    np.testing.assert_array_equal(count_labels(grid, labels, count), counted(labels, size, count))


def test_renumber_by_hand():
    labels = np.array([[-1, 0, 1], [2, 3, 2]], np.int32)
    np.testing.assert_array_equal(relabel_sequential(labels, np.array([2, 0]), 4),
                                  [[-1, 1, -1], [0, -1, 0]])
    np.testing.assert_array_equal(relabel_sequential(labels, np.arange(4), 4), labels)
    assert (relabel_sequential(labels, np.array([], int), 4) == -1).all()


@pytest.mark.parametrize('camera', [
    CameraIntrinsics(525.0, 525.0, 319.5, 239.5, 640, 480),
    CameraIntrinsics(210.0, 305.0, 125.0, 150.0, 320, 240)])
def test_covariance_and_confidence_follow_from_the_fit(camera):
    """The noise of (a, b, c) by the normal equations, carried on by numerical derivatives."""
    sums, plane = np.zeros(SUMS), np.array([0.1, -0.3, 0.5])
    x, y = (grid.ravel() for grid in np.meshgrid(np.linspace(-0.1, 0.2, 30),
                                                 np.linspace(0.05, 0.3, 20)))
    y = y + 0.5 * x
    design = np.stack([x, y, np.ones(600)])
    d = plane @ design
    sums[:10] = [600, x.sum(), y.sum(), x @ x, x @ y, y @ y, d.sum(), x @ d, y @ d, d @ d]
    sums[10:15] = [(x / d).sum(), (y / d).sum(), (1 / d).sum(), (1 / d**3).sum(), 600 * 0.03**2]
    shape = camera.height, camera.width
    grid = build_cell_grid(DisparityImage(np.ones(shape, np.float32), np.ones(shape, bool)))
    regions = PixelRegions(np.ones((1, 1)), np.zeros((1, 1), np.int32), plane[None], grid,
                           Noise(0.0, pixel_sigma=0.02))
    measured, = planes_from_sums(regions, sums[None], np.array([0]), camera)

    def equation(coefficients):
        ray = ray_plane_jacobian(camera) @ coefficients
        return np.append(-ray, 1) / np.linalg.norm(ray)

    steps = 1e-6 * np.eye(3)
    chain = np.stack([(equation(plane + step) - equation(plane - step)) / 2e-6 for step in steps])
    expected = 0.02**2 * chain.T @ np.linalg.inv(design @ design.T) @ chain
    np.testing.assert_allclose(measured.covariance, expected, rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose([*measured.normal, measured.offset_m], equation(plane))
    assert measured.rms_m == pytest.approx(0.03 * measured.offset_m)
    pixels = camera.width * camera.height
    logit = [1, np.log(600 / pixels), np.log(np.trace(expected[:3, :3])) / 2] @ np.array(
        CONFIDENCE_WEIGHTS)
    assert measured.confidence == pytest.approx(1 / (1 + np.exp(-logit)), rel=1e-4)
    rough = sums.copy()
    rough[14] *= 100
    clutter, = planes_from_sums(regions, rough[None], np.array([0]), camera)
    assert clutter.confidence < 0.1 * measured.confidence  # its rms is above its extent
    of_network = replace(regions, noise=replace(regions.noise, source_sigma=1e-6))
    bent, = planes_from_sums(of_network, rough[None], np.array([0]), camera)
    assert bent.confidence == pytest.approx(measured.confidence, rel=1e-3)


@pytest.mark.parametrize(('noise', 'is_noted'), [(0.01, False), (0.2, True)])
def test_noise_is_noted_only_if_it_can_hide_planes(noise, is_noted):
    shape = 48, 64
    ones = DisparityImage(np.ones(shape, np.float32), np.ones(shape, bool))
    regions = PixelRegions(ones.values, np.zeros(shape, np.int32), np.array([[0.0, 0.0, 1.0]]),
                           build_cell_grid(ones, 4), Noise(0.0, mean_sigma=noise))
    nowhere = np.full(shape, -1, np.int32)  # as where lines of the image speak against the plane
    assert ('noise' in missing_planes_note(regions, nowhere, 10.0)) == is_noted
