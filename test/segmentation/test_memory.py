# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What a stream remembers of its planes: they stay, what comes is there at once, errors die."""

from copy import deepcopy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from plane_detector import CameraIntrinsics, Config, PlaneDetector
from plane_detector.config import DepthConfig, SegmentationConfig
from plane_detector.evaluation.metrics import overlap, segmentation_covering
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rendering import (
    Rectangle,
    box,
    camera_rotation,
    render,
)
from plane_detector.evaluation.scenes.rooms import random_room
from plane_detector.evaluation.scenes.terrain import Course, Kind, View, look
from plane_detector.evaluation.scenes.terrain import noisy as terrain_noise
from plane_detector.geometry.disparity import to_disparity
from plane_detector.geometry.projection import depth_to_points
from plane_detector.pipeline import segment_planes
from plane_detector.segmentation.cells.grid import lens_of
from plane_detector.segmentation.memory import NO_MEMORY
from plane_detector.segmentation.segment import metric_noise_floor, segment, segment_next

CAMERA = CameraIntrinsics(262.5, 262.5, 159.5, 119.5, 320, 240)
DEPTH = Config(depth=DepthConfig(source='topic'))
NOISE = 0.004  # 1/m


@cache
def room(seed=300):
    return random_room(np.random.default_rng(seed), CAMERA)


@cache
def table_top(*crates):
    """Return a room with a table from above it, and crates (x, height) on the table."""
    surfaces = box([0, 0, 1.25], [4, 5, 2.5]) + box([0, 1.2, 0.35], [1.4, 0.8, 0.7])
    for x, height in crates:
        surfaces += box([x, 1.15, 0.7 + height / 2], [0.3, 0.3, height], 10)
    return render(surfaces, camera_rotation(0, -25, 0), np.array([0, -0.3, 1.4]), CAMERA,
                  np.random.default_rng(0))


def noisy(scenes, seed=0, sigma=NOISE):
    rng = np.random.default_rng(seed)
    return [with_disparity_noise(scene.depth_m, sigma, rng) for scene in scenes]


def next_labels(memory, depth_m, camera=CAMERA):
    """Return the labels of the next image and the memory after it."""
    config = Config()
    regions, memory = segment_next(memory, to_disparity(depth_m), metric_noise_floor(config),
                                   config, lens=lens_of(camera))
    return regions.labels, memory


def labels_of(depths, memory=NO_MEMORY):
    found = []
    for depth_m in depths:
        labels, memory = next_labels(memory, depth_m)
        found.append(labels)
    return found


def single(depth_m):
    config = Config()
    return segment(to_disparity(depth_m), metric_noise_floor(config), config,
                   lens=lens_of(CAMERA)).labels


def likeness(one, other):
    return segmentation_covering(overlap(one, other, np.ones(one.shape, bool)).counts)


def planes_lost(labels):
    """Return how many planes of over 2 % of an image have none with IoU > .5 in the next."""
    lost = 0
    for before, after in zip(labels[:-1], labels[1:], strict=True):
        shared = overlap(before, after, np.ones(before.shape, bool))
        large = shared.counts[:-1].sum(1) > 0.02 * before.size
        lost += np.count_nonzero(shared.iou[large].max(axis=1, initial=0.0) <= 0.5)
    return lost


def detections(detector, depths, stamps=None):
    black = np.zeros((*depths[0].shape, 3), np.uint8)
    stamps = stamps or [k / 30 for k in range(len(depths))]
    return [detector.detect(black, CAMERA, depth_m, stamp_s=stamp_s)
            for depth_m, stamp_s in zip(depths, stamps, strict=True)]


def test_without_memory_each_image_is_segmented_by_itself():
    depths = noisy([room()] * 4)
    off = replace(DEPTH, segmentation=SegmentationConfig(memory=False))
    for depth_m, found in zip(depths, detections(PlaneDetector(off), depths), strict=True):
        assert likeness(segment_planes(depth_m, CAMERA).labels, found.labels) == 1.0
        np.testing.assert_array_equal(segment_planes(depth_m, CAMERA).labels, found.labels)


def test_the_first_image_is_segmented_by_itself():
    depth_m, = noisy([room()])
    np.testing.assert_array_equal(next_labels(NO_MEMORY, depth_m)[0], single(depth_m))


def test_a_standing_noisy_camera_keeps_its_planes():
    kept = alone = 0
    for seed in (9300, 9301, 9302, 9303):
        depths = noisy([room(seed)] * 8, seed, 0.01)
        kept += planes_lost(labels_of(depths))
        alone += planes_lost([single(depth_m) for depth_m in depths])
    assert 2 * kept <= alone


def test_segmentation_with_memory_is_pure():
    first, second = noisy([room()] * 2)
    _, memory = next_labels(NO_MEMORY, first)
    before = deepcopy(memory)
    one, other = (next_labels(memory, second)[0] for _ in range(2))
    np.testing.assert_array_equal(one, other)
    for was, part in zip(vars(before).values(), vars(memory).values(), strict=True):
        np.testing.assert_array_equal(part, was)


@pytest.mark.parametrize('height_m', [0.06, 0.2])
def test_what_comes_is_there_in_the_first_image_and_gone_within_two(height_m):
    empty, full = table_top(), table_top((0.1, height_m))
    top = full.labels == np.bincount(full.labels[full.labels >= len(empty.planes)]).argmax()
    beside = (full.labels == empty.labels[top][0]) & ~top
    found = labels_of(noisy([empty] * 5 + [full] * 3 + [empty] * 3, sigma=0.001))

    def is_apart(labels):
        on_top, table = (np.bincount(labels[where] + 1) for where in (top, beside))
        return (on_top.argmax() not in (0, table.argmax())
                and on_top.max() > 0.5 * np.count_nonzero(top))
    assert [is_apart(labels) for labels in found[:8]] == [False] * 5 + [True] * 3
    assert not is_apart(found[10])


def moving(what):
    """Return nine scenes of a standing camera before which something moves."""
    scenes = []
    for k in range(9):
        surfaces = box([0, 0, 1.25], [4, 5, 2.5]) + box([0.5, 1.6, 0.35], [1.2, 0.8, 0.7])
        if what == 'cart':
            surfaces += box([-1.2 + 0.3 * k, 0.9, 0.3], [0.5, 0.4, 0.6], 15)
        elif what == 'door':
            turn = np.radians(10 * k)
            surfaces += [Rectangle(np.array([-1.5, 2.2, 0.0]),
                                   0.9 * np.array([np.cos(turn), -np.sin(turn), 0.0]),
                                   np.array([0.0, 0.0, 2.0]))]
        else:  # an arm over the table
            surfaces += box([-0.4 + 0.2 * k, 1.4, 0.9], [0.12, 0.7, 0.08], 20)
        scenes.append(render(surfaces, camera_rotation(0, -15, 0), np.array([0, -1.2, 1.4]),
                             CAMERA, np.random.default_rng(0)))
    return scenes


@pytest.mark.parametrize('what', ['cart', 'door', 'arm'])
def test_what_moves_does_not_stick(what):
    """Each image is as near to the truth as without memory, also where something just was."""
    scenes = moving(what)
    depths = noisy(scenes, sigma=0.002)
    for k, labels in enumerate(labels_of(depths)):
        truth, alone = scenes[k].labels, single(depths[k])
        assert likeness(truth, labels) > likeness(truth, alone) - 0.02
        if k >= 2:  # uncovered by what was there two images ago: of the surface behind
            uncovered = scenes[k].depth_m > scenes[k - 2].depth_m + 0.1
            behind = np.bincount(truth[uncovered]).argmax()
            at, around = uncovered & (truth == behind), (truth == behind) & ~uncovered
            label = np.bincount(labels[around] + 1).argmax() - 1
            assert np.mean(labels[at] == label) > 0.9


def remembered(memory, labels, planes):
    """Return a memory of other pieces, without evidence."""
    empty = np.zeros((len(memory.evidence), len(planes), len(planes)))
    return replace(memory, labels=labels, planes=planes, evidence=empty, images=empty.astype(int))


@pytest.mark.parametrize(('error', 'images'), [
    ('one plane', 1), ('curved', 1), ('cut', 1), ('shifted', 1), ('shifted by a row', 1),
    ('another scene', 1), ('evidence', 10), ('noise', 10)])
def test_a_wrong_memory_is_forgotten_within_so_many_images(error, images):
    depths = noisy([room()] * (images + 7), sigma=0.002)
    _, memory = next_labels(NO_MEMORY, depths[0])
    labels, planes = memory.labels, memory.planes
    if error == 'one plane':
        wrong = remembered(memory, np.minimum(labels, 0), planes[:1])
    elif error == 'curved':
        wrong = replace(memory, planes=np.full_like(planes, -1))
    elif error == 'cut':
        rows, columns = np.indices(labels.shape)
        pieces = (rows // 8 * 20 + columns // 8).astype(np.int32)
        wrong = remembered(memory, pieces, np.arange(pieces.max() + 1))
    elif error == 'shifted':
        wrong = replace(memory, labels=np.roll(labels, (6, 12), (0, 1)))
    elif error == 'shifted by a row':
        wrong = replace(memory, labels=np.roll(labels, 1, 0))
    elif error == 'evidence':  # for two planes everywhere, of the most images
        wrong = replace(memory, evidence=np.ones_like(memory.evidence),
                        images=np.full_like(memory.images, 10))
    elif error == 'noise':  # three times as much, of the most images
        noise = replace(memory.noise, mean_sigma=3 * memory.noise.mean_sigma)
        wrong = replace(memory, noise=noise, noise_images=10.0)
    else:
        wrong = next_labels(NO_MEMORY, noisy([room(303)])[0])[1]
    last, truth = labels_of(depths[1:], wrong)[images:], room().labels
    alone = [single(depth_m) for depth_m in depths[images + 1:]]
    assert (np.mean([likeness(truth, labels) for labels in last])
            > np.mean([likeness(truth, labels) for labels in alone]) - 0.02)


def test_evidence_is_that_of_a_pair_and_counts_once_an_image():
    depths = noisy([room()] * 4, sigma=0.01)
    memory, images = NO_MEMORY, []
    for depth_m in depths:
        _, memory = next_labels(memory, depth_m)
        np.testing.assert_array_equal(memory.evidence, memory.evidence.transpose(0, 2, 1))
        assert (abs(memory.evidence) <= 1).all()
        images.append(memory.images.max(initial=0))
    # The decision of the first image counts as one.
    assert images == [0, 2, 3, 4]


def test_the_noise_is_the_mean_of_about_ten_images_of_one_scene():
    depths, memory, images, means = noisy([room()] * 14, sigma=0.01), NO_MEMORY, [], []
    for depth_m in depths + noisy([room(303)], sigma=0.01):
        _, memory = next_labels(memory, depth_m)
        images.append(memory.noise_images)
        means.append(memory.noise.mean_sigma)
    assert images[:2] == [0.0, 1.0] and 1.9 < images[2] <= 2.0
    assert 8 < images[13] <= 10 and images[14] < 3
    # It neither wanders off nor jumps.
    assert max(means[5:14]) < 1.1 * min(means[5:14])


@cache
def floor(*boxes):
    """Return a room from 1.2 m above its floor, and boxes (x, height) on the floor."""
    surfaces = box([0, 0, 1.25], [4, 5, 2.5])
    for x, height in boxes:
        surfaces += box([x, 0.9, height / 2], [0.4, 0.3, height], 10)
    return render(surfaces, camera_rotation(0, -25, 0), np.array([0, -1.0, 1.2]), CAMERA,
                  np.random.default_rng(0))


def test_an_obstacle_is_published_in_the_first_image_that_shows_it_and_gone_in_the_first_without():
    empty, full = floor(), floor((0.1, 0.25))
    inside = full.labels >= len(empty.planes)
    was_floor = inside & (full.depth_m < empty.depth_m - 0.1)
    depths, shares = noisy([empty] * 4 + [full] * 2 + [empty] * 2, sigma=0.001), []
    detector, black = PlaneDetector(DEPTH), np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    for k, depth_m in enumerate(depths):
        found = detector.detect(black, CAMERA, depth_m, full.gravity_camera, stamp_s=k / 30,
                                camera_height_m=1.2)
        shares.append((found.obstacles[was_floor].mean(), found.ground[was_floor].mean()))
    assert np.mean(was_floor) > 0.01
    for obstacle, on_ground in shares[4:6]:
        assert obstacle > 0.9 and on_ground < 0.1
    for obstacle, on_ground in shares[:4] + shares[6:]:
        assert obstacle < 0.1 and on_ground > 0.9


def test_a_drop_is_published_in_the_first_image_that_shows_it_and_gone_in_the_first_without():
    views = []
    for lower_m in (0.0, -0.2):
        way = Course(2.0)
        way.on(1.6, 0.0, Kind.FLOOR)
        if lower_m:
            way.on(1.6, lower_m, Kind.OBSTACLE)
        way.on(9.0, lower_m, Kind.LOWER)
        views.append(look(way, View(0.6, 20.0, roll_deg=3.0), np.random.default_rng(0)))
    flat, drop = views
    detector, rng = PlaneDetector(DEPTH), np.random.default_rng(0)
    for k, view in enumerate([flat] * 4 + [drop] * 3 + [flat] * 3):
        scene = view.scene
        found = detector.detect(scene.rgb, scene.intrinsics, terrain_noise(view, 0.001, rng),
                                scene.gravity_camera, stamp_s=k / 30)
        if view is flat:
            assert not len(found.drops_m)
        else:
            assert len(found.drops_m) > 100
            np.testing.assert_allclose(view.in_world(found.drops_m)[:, 1], 1.6, atol=0.05)


def test_a_person_who_passes_leaves_nothing_behind():
    """In every image the person is an obstacle, and what was behind is what it was before."""
    surfaces, detector = box([0, 0, 1.25], [4, 5, 2.5]), PlaneDetector(DEPTH)
    before = None
    for k in range(12):
        person = box([-1.6 + 0.35 * k, 0.6, 0.85], [0.45, 0.25, 1.7], 13.0 * k)
        scene = render(surfaces + (person if 2 <= k < 9 else []), camera_rotation(0, -20, 0),
                       np.array([0, -1.5, 1.2]), CAMERA, np.random.default_rng(0))
        depth_m, = noisy([scene], k, 0.001)
        found = detector.detect(scene.rgb, CAMERA, depth_m, scene.gravity_camera,
                                stamp_s=k / 30)
        is_person = scene.rectangles[scene.labels] >= len(surfaces)
        heights_m = 1.2 - depth_to_points(scene.depth_m, CAMERA) @ scene.gravity_camera
        is_floor = (heights_m < 0.01) & ~is_person
        assert found.ground[is_floor].mean() > 0.98
        if is_person.sum() > 500:
            assert found.obstacles[is_person & (heights_m > 0.1)].mean() > 0.97
        if before is not None:
            uncovered = before & ~is_person
            if (uncovered & is_floor).sum() > 200:
                assert found.ground[uncovered & is_floor].mean() > 0.95
                assert found.obstacles[uncovered & is_floor].mean() < 0.05
        before = is_person


def test_a_memory_of_another_size_or_lens_does_not_count():
    depth_m, other_m = noisy([room()] * 2)
    _, memory = next_labels(NO_MEMORY, depth_m)
    half = np.ascontiguousarray(other_m[::2, ::2])
    of_half = CameraIntrinsics(131.25, 131.25, 79.5, 59.5, 160, 120)
    for depth, lens in ((half, of_half), (other_m, replace(CAMERA, fx=300.0, fy=300.0))):
        np.testing.assert_array_equal(next_labels(memory, depth, lens)[0],
                                      next_labels(NO_MEMORY, depth, lens)[0])


@pytest.mark.parametrize('how', ['reset', 'jump back in time'])
def test_a_new_epoch_starts_without_memory(how):
    depths, detector = noisy([room()] * 3, sigma=0.01), PlaneDetector(DEPTH)
    detections(detector, depths[:2], [10.0, 10.03])
    if how == 'reset':
        detector.reset()
    found, = detections(detector, depths[2:], [10.07 if how == 'reset' else 1.0])
    np.testing.assert_array_equal(found.labels, detections(PlaneDetector(DEPTH), depths[2:])[0]
                                  .labels)


def test_a_stream_that_starts_later_agrees_from_its_second_image_on():
    depths = noisy([room()] * 8, sigma=0.002)
    whole, later = labels_of(depths), labels_of(depths[4:])
    assert min(map(likeness, whole[5:], later[1:])) >= 0.97
    for one, other in zip(whole, labels_of(depths), strict=True):
        np.testing.assert_array_equal(one, other)
