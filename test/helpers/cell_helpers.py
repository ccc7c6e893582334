# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Rendered views and the models of their cells, for tests of code that works on cells."""

from functools import cache

import numpy as np

from plane_detector.config import Config
from plane_detector.evaluation.metrics import overlap, score
from plane_detector.evaluation.peers import plane_array
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rendering import VGA, camera_rotation, rectangle, render
from plane_detector.evaluation.scenes.surfaces import ellipsoid
from plane_detector.geometry.disparity import to_disparity, zero_filled
from plane_detector.segmentation.cells.grid import DisparityImage, build_cell_grid, fit_planes
from plane_detector.segmentation.cells.model import Frame, PlaneRegions, add_up, weigh_cells
from plane_detector.segmentation.cells.noise import Noise, estimate_noise
from plane_detector.segmentation.segment import DEPTH_FLOOR_M, segment, unitless_noise_floor

EXACT = Noise(DEPTH_FLOOR_M)
"""No noise but the floor."""


def view(rectangles, curved=(), intrinsics=VGA, angles_deg=(0, 0, 0)):
    """Return the view of a camera at the origin looking along y, rotated by yaw, pitch, roll."""
    return render(rectangles, camera_rotation(*angles_deg), np.zeros(3), intrinsics,
                  np.random.default_rng(0), curved)


def wall(distance_m, left_m=-50.0, right_m=50.0):
    """Return an infinite wall perpendicular to y, or a vertical strip of one."""
    return rectangle([left_m, distance_m, -50], [right_m - left_m, 0, 0], [0, 0, 100])


FLOOR = rectangle([-9, -1, -1.2], [18, 0, 0], [0, 9, 0])


def ball(radius):
    return ellipsoid(radius, radius).at(0, 2 + radius)


def fold(angle_deg, width_m=3.0):
    """Return two vertical planes that meet 2 m ahead."""
    half = np.radians(angle_deg / 2)
    across, back = width_m * np.cos(half), width_m * np.sin(half)
    return [rectangle([0, 2, -50], [across, back, 0], [0, 0, 100]),
            rectangle([-across, 2 + back, -50], [across, -back, 0], [0, 0, 100])]


def millimetres(depth_m):
    """Return depth rounded to 16-bit millimetres."""
    return (np.rint(depth_m * 1000) / 1000).astype(np.float32)


def disparity_image(depth_m):
    """Return the disparity of a depth image and where it is valid."""
    return DisparityImage(*zero_filled(to_disparity(depth_m)))


def cell_model(depth_m, noise=EXACT):
    return weigh_cells(build_cell_grid(disparity_image(depth_m)), noise)


def frame_of(image, cells, noise=EXACT, min_pixels=600):
    """Return what the search and the stages after it take."""
    return Frame(image, cells.grid, noise, min_pixels, Config(), np.random.default_rng(0))


def noisy(scene, seed, sigma=0.01, **kind):
    """Return the depth of a view under noise, half of whose variance is smooth by default."""
    if sigma == 0:
        return scene.depth_m
    return with_disparity_noise(scene.depth_m, sigma, np.random.default_rng(seed), **kind)


def cells_and_noise(depth_m):
    """Return the cells of a depth image and the noise that is estimated from them."""
    noise = estimate_noise(build_cell_grid(disparity_image(depth_m)), EXACT)
    return cell_model(depth_m, noise), noise


@cache
def bare_wall():
    """Return a wall 2.5 m ahead that fills the image."""
    return view([wall(2.5)])


@cache
def rough_wall(power, seed, length_cells=4.0, sigma=0.003):
    """Return its depth with noise whose cells correlate by exp(-(r / length)**power)."""
    lag = np.minimum(np.arange(128), 128 - np.arange(128))
    spectrum = np.fft.fft2(np.exp(-(np.hypot(lag[:, None], lag) / length_cells) ** power)).real
    rng = np.random.default_rng(seed)
    white = np.fft.fft2(rng.standard_normal(spectrum.shape))
    field = np.fft.ifft2(white * np.sqrt(np.maximum(spectrum, 0))).real[:60, :80]
    noise = np.kron(field, np.ones((8, 8))) + 0.5 * rng.standard_normal((480, 640))
    return (1 / (1 / bare_wall().depth_m + sigma * noise)).astype(np.float32)


def relative_labels(disparity):
    """Return the plane of each pixel of a disparity of unknown scale and shift."""
    return segment(disparity, unitless_noise_floor(disparity), Config()).labels


def regions_of_labels(model, labels):
    """Return regions of given labels (R, C) with the planes that fit their flat cells."""
    labels = labels.astype(np.int32)
    moments = add_up(model.grid.moments, labels.ravel(), model.is_planar, labels.max() + 1)
    return PlaneRegions(labels, fit_planes(moments))


def one_patch(model):
    return regions_of_labels(model, np.zeros(model.grid.shape, int))


def best_iou(scene, labels):
    """Return for each true plane the IoU with the label that it shares most with."""
    return overlap(scene.labels, labels, np.isfinite(scene.depth_m)).iou.max(axis=1, initial=0)


def scored(scene, found, **options):
    """Return the metrics of a segmentation of a scene."""
    return score(scene.labels, scene.planes, found.labels, plane_array(found),
                 np.isfinite(scene.depth_m), **options)
