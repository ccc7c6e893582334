# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Edges and lines of an image that are none of its depth do not make a good depth worse."""

import cv2
import numpy as np
import pytest

from plane_detector import Config, PlaneDetector
from plane_detector.config import DirectionsConfig, SegmentationConfig
from plane_detector.depth.observation import DepthFunction
from plane_detector.evaluation.metrics import overlap, pure_errors, segmentation_covering
from plane_detector.evaluation.peers import plane_array
from plane_detector.evaluation.scenes import rooms
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.geometry.projection import depth_to_points


def posters(rng, u, v):
    """Return the brightness of rectangles, each rotated by any angle in its plane."""
    grey = np.full(len(u), rng.uniform(70, 210))
    for _ in range(rng.integers(2, 6)):
        middle, angle = rng.integers(len(u)), rng.uniform(0, np.pi)
        across, along = rotated(u - u[middle], v - v[middle], angle)
        half = rng.uniform([0.15, 0.2], [0.6, 1.0])
        grey[(np.abs(across) < half[0]) & (np.abs(along) < half[1])] = rng.uniform(20, 240)
    return grey


def stripes(rng, u, v):
    """Return the brightness of stripes in any direction."""
    across = rotated(u, v, rng.uniform(0, np.pi))[0]
    return np.where(across % rng.uniform(0.2, 0.6) < 0.1, *rng.uniform([20, 140], [110, 240]))


def diagonal_tiles(rng, u, v):
    """Return the brightness of square tiles, laid at any angle."""
    size = rng.uniform(0.25, 0.6)
    across, along = rotated(u, v, rng.uniform(0, np.pi / 2))
    is_joint = (across % size < 0.03) | (along % size < 0.03)
    return np.where(is_joint, *rng.uniform([20, 140], [110, 240]))


PATTERNS = {'posters': posters, 'stripes': stripes, 'diagonal tiles': diagonal_tiles}
FALSE_COLOURS = 'false colours'
KINDS = (*PATTERNS, FALSE_COLOURS)


def misleading_image(scene, kind, rng):
    """Return an image (H, W, 3) uint8 of a scene with exact depth; the kind is one of KINDS."""
    if kind == FALSE_COLOURS:
        return false_colours(scene.labels.shape, rng)
    points_m, grey = depth_to_points(scene.depth_m, scene.intrinsics), np.zeros(scene.labels.shape)
    for k, plane in enumerate(scene.planes):
        mask = scene.labels == k
        along = np.linalg.svd(plane[None, :3])[2][1:]
        grey[mask] = PATTERNS[kind](rng, *(along @ points_m[mask].T))
    grey = cv2.GaussianBlur(grey, (0, 0), 0.6)[..., None] + rng.normal(0, 3, (*grey.shape, 1))
    return np.clip(grey * rng.uniform(0.85, 1.0, 3), 0, 255).astype(np.uint8)


def false_colours(shape, rng):
    """Return Voronoi cells of random places, each of one colour."""
    places = rng.uniform([0, 0], shape, (rng.integers(15, 40), 2))
    row, column = np.mgrid[:shape[0], :shape[1]]
    nearest = np.full(shape, np.inf)
    image = np.zeros((*shape, 3), np.uint8)
    for place in places:
        distance = (row - place[0]) ** 2 + (column - place[1]) ** 2
        image[distance < nearest] = rng.integers(0, 256, 3)
        nearest = np.minimum(distance, nearest)
    return image


def rotated(u, v, angle):
    return np.cos(angle) * u + np.sin(angle) * v, np.cos(angle) * v - np.sin(angle) * u


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
