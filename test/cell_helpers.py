# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Rendered views and the models of their cells, for the tests of what works on cells."""

import numpy as np

from plane_detector.cells import fit_planes, make_cells
from plane_detector.config import Config
from plane_detector.noise import Noise
from plane_detector.ransac import Patches, make_model
from plane_detector.segmentation import to_disparity
from plane_detector.tools.metrics import overlap
from plane_detector.tools.scenes import VGA, Rectangle, camera_rotation, render
from plane_detector.tools.surfaces import ellipsoid

EXACT = Noise(Config().ransac.noise_floor)
"""No noise but the floor."""


def rectangle(corner, edge_u, edge_v):
    return Rectangle(*(np.array(vector, float) for vector in (corner, edge_u, edge_v)))


def view(rectangles, curved=(), intrinsics=VGA, angles_deg=(0, 0, 0)):
    """Return what a camera at the origin sees that looks along y, turned by yaw, pitch, roll."""
    return render(rectangles, camera_rotation(*angles_deg), np.zeros(3), intrinsics,
                  np.random.default_rng(0), curved)


def wall(distance_m, left_m=-50.0, right_m=50.0):
    """Return an endless wall square to y, or an upright strip of one."""
    return rectangle([left_m, distance_m, -50], [right_m - left_m, 0, 0], [0, 0, 100])


FLOOR = rectangle([-9, -1, -1.2], [18, 0, 0], [0, 9, 0])


def ball(radius):
    return ellipsoid(radius, radius).at(0, 2 + radius)


def fold(angle_deg, width_m=3.0):
    """Return two upright planes that meet 2 m ahead."""
    half = np.radians(angle_deg / 2)
    across, back = width_m * np.cos(half), width_m * np.sin(half)
    return [rectangle([0, 2, -50], [across, back, 0], [0, 0, 100]),
            rectangle([-across, 2 + back, -50], [across, -back, 0], [0, 0, 100])]


def millimetres(depth_m):
    """Return depth as 16-bit millimetres keep it."""
    return (np.rint(depth_m * 1000) / 1000).astype(np.float32)


def cell_model(depth_m, noise=EXACT):
    return make_model(make_cells(*to_disparity(depth_m)), noise)


def hand_made(model, labels):
    """Return patches of given labels (R, C) with the planes that fit their flat cells."""
    members = (labels.ravel() == np.arange(labels.max() + 1)[:, None]) & model.planar
    return Patches(labels.astype(np.int32), fit_planes(members @ model.grid.moments))


def one_patch(model):
    return hand_made(model, np.zeros(model.grid.shape, int))


def best_iou(scene, labels):
    """Return for each true plane the IoU with the label that it shares most with."""
    return overlap(scene.labels, labels, np.isfinite(scene.depth_m)).iou.max(axis=1, initial=0)
