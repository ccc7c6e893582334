# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Classes and confidences of planes in a stream: noise does not switch them, what turns does."""

from dataclasses import replace

import numpy as np
import pytest

from plane_detector import CameraIntrinsics, Config, PlaneDetector
from plane_detector.config import DepthConfig, SegmentationConfig, TrackingConfig
from plane_detector.evaluation.scenes.noise import with_disparity_noise
from plane_detector.evaluation.scenes.rendering import (
    Rectangle,
    box,
    camera_rotation,
    render,
)
from plane_detector.planes.classification import PlaneClass, classify_planes
from plane_detector.planes.history import MOST_IMAGES, NO_HISTORY, PlaneHistory
from plane_detector.types import NO_PLANES, Plane, Planes

CAMERA = CameraIntrinsics(262.5, 262.5, 159.5, 119.5, 320, 240)
DOWN = np.array([0.0, 1.0, 0.0])
DEPTH = Config(depth=DepthConfig(source='topic'))
ALONE = replace(DEPTH, segmentation=SegmentationConfig(memory=False))
KINDS = {PlaneClass.WALL: 90.0, PlaneClass.OTHER_HORIZONTAL: 0.0}


def leaning(off_level_deg, sigma_deg=1.0, label=1, confidence=0.8):
    """Return a plane that faces up, or ahead at 90 degrees."""
    angle, sigma_rad = np.radians(off_level_deg), np.radians(sigma_deg)
    normal = np.array([0.0, -np.cos(angle), -np.sin(angle)])
    return Plane(normal, 2.0, -2.0 * normal, 1000, 0.0, 1.0,
                 np.diag([1.0, 1.0, 1.0, 0.0]) * sigma_rad**2 / 3, confidence, label=label)


def seen(history, *planes):
    """Return the classes of the planes of the next image, and the history after it."""
    found = Planes.of(planes)
    past = history.of(found, CAMERA).inclined(found, DOWN)
    found = replace(found, confidences=past.mean_confidences(found),
                    classes=classify_planes(found, DOWN, past))
    return found, past.after(found)


def classes_of(angles_deg, sigma_deg=1.0):
    """Return the class of one plane in images that show it at these angles."""
    history, classes = NO_HISTORY, []
    for angle_deg in angles_deg:
        found, history = seen(history, leaning(angle_deg, sigma_deg))
        classes.append(PlaneClass(found.classes[0]))
    return classes


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('off_deg', [7.0, 8.0, 9.0])
def test_noise_about_the_limit_of_a_class_switches_it_once_at_most(kind, off_deg):
    """Alone, at the limit, every other image is of another class."""
    angles_deg = KINDS[kind] + np.copysign(off_deg, -KINDS[kind]) + np.random.default_rng(
        0).normal(0, 1.5, 40)
    planes = [Planes.of([leaning(angle)]) for angle in angles_deg]
    alone = np.array([classify_planes(one, DOWN)[0] for one in planes])
    found = np.array(classes_of(angles_deg, 1.5))
    assert np.count_nonzero(np.diff(found)) <= 1
    assert off_deg != 8.0 or np.count_nonzero(np.diff(alone.astype(int))) >= 10


@pytest.mark.parametrize(('off_deg', 'is_level'), [(5.5, True), (10.5, False)])
def test_off_the_limit_the_class_is_the_true_one_from_whichever_it_had(off_deg, is_level):
    kinds = {True: PlaneClass.OTHER_HORIZONTAL, False: PlaneClass.OTHER}
    for begins_deg in (7.0, 9.0):  # as noise makes it seem first
        assert classes_of([begins_deg, *[off_deg] * MOST_IMAGES])[-1] is kinds[is_level]


@pytest.mark.parametrize('kind', KINDS)
def test_what_turns_has_its_class_in_the_image_that_shows_it(kind):
    other = KINDS.keys() - {kind}
    steady = [KINDS[kind] + 0.5 * (-1) ** k for k in range(15)]
    turned = [KINDS[next(iter(other))]]
    assert classes_of(steady + turned)[-2:] == [kind, *other]
    # Half way it is neither, also of a plane that turns slowly.
    assert classes_of([*steady, 45.0])[-1] is PlaneClass.OTHER
    assert classes_of(np.linspace(KINDS[kind], 45.0, 20))[-1] is PlaneClass.OTHER


def test_a_new_plane_is_judged_by_its_image_alone():
    history = NO_HISTORY
    for _ in range(5):
        _, history = seen(history, leaning(90.0, label=1, confidence=0.9))
    new = leaning(0.0, label=2, confidence=0.3)
    found, _ = seen(history, leaning(90.0, label=1, confidence=0.9), new)
    assert found.classes.tolist() == [PlaneClass.WALL, PlaneClass.OTHER_HORIZONTAL]
    assert found.confidences.tolist() == pytest.approx([0.9, 0.3])


def test_a_confidence_is_the_mean_of_ten_images():
    history, shown = NO_HISTORY, []
    for k in range(30):
        found, history = seen(history, leaning(0.0, confidence=0.5 + 0.4 * (k % 2)))
        shown.append(found.confidences[0])
    assert shown[:3] == pytest.approx([0.5, 0.7, 0.6333], abs=1e-3)
    assert np.ptp(shown[10:]) < 0.05 and np.mean(shown[10:]) == pytest.approx(0.7, abs=0.01)
    for _ in range(MOST_IMAGES):  # and is forgotten by and by
        found, history = seen(history, leaning(0.0, confidence=0.2))
    assert found.confidences[0] < 0.2 + 0.5 * np.exp(-1)


def test_without_planes_there_is_no_history():
    _, history = seen(NO_HISTORY, leaning(0.0))
    past = history.of(NO_PLANES, CAMERA).inclined(NO_PLANES, DOWN)
    assert past.mean_confidences(NO_PLANES).size == 0 and not past.after(NO_PLANES).labels.size
    assert isinstance(past, PlaneHistory)


def test_planes_of_another_camera_are_new():
    _, history = seen(NO_HISTORY, leaning(0.0))
    found = Planes.of([leaning(0.0)])
    assert history.of(found, CAMERA).images.tolist() == [1]
    half = CameraIntrinsics(131.25, 131.25, 79.5, 59.5, 160, 120)
    for other in (half, replace(CAMERA, fx=300.0)):
        assert history.of(found, other).images.tolist() == [0]


def panel(off_deg):
    """Return a room from 1.2 m above its floor, in which a panel leans by so much."""
    up = np.array([0.0, np.sin(np.radians(off_deg)), np.cos(np.radians(off_deg))])
    surfaces = box([0, 0, 1.25], [4, 5, 2.5]) + [
        Rectangle(np.array([-0.8, 1.0, 0.02]), np.array([1.6, 0.0, 0.0]), 1.0 * up)]
    return render(surfaces, camera_rotation(0, -15, 0), np.array([0, -1.2, 1.2]), CAMERA,
                  np.random.default_rng(0))


def detections(config, scenes, sigma=0.01, start_s=0.0, detector=None):
    rng, detector = np.random.default_rng(0), detector or PlaneDetector(config)
    return [detector.detect(scene.rgb, CAMERA, with_disparity_noise(scene.depth_m, sigma, rng),
                            scene.gravity_camera, stamp_s=start_s + k / 30)
            for k, scene in enumerate(scenes)]


def by_network(config, scenes):
    """Detect as :func:`detections`, with the depth as that of a network."""
    rng, depths = np.random.default_rng(0), []
    for scene in scenes:
        depths.append(with_disparity_noise(scene.depth_m, 0.01, rng))
    config, images = replace(config, depth=DepthConfig()), iter(depths)
    detector = PlaneDetector(config, lambda rgb: next(images))
    return [detector.detect(scene.rgb, CAMERA, None, scene.gravity_camera, stamp_s=k / 30)
            for k, scene in enumerate(scenes)]


def classes_at(found, where):
    """Return the class of the plane on most pixels of a mask."""
    labels = [np.bincount(one.labels[where] + 1).argmax() - 1 for one in found]
    return np.array([one.planes.classes[k] if k >= 0 else 99
                     for one, k in zip(found, labels, strict=True)], int)


@pytest.mark.parametrize(('detect', 'share'), [(detections, 0.1), (by_network, 0.6)])
def test_the_class_of_a_steady_plane_does_not_switch_in_a_stream(detect, share):
    """A network's regions are not remembered: one plane of an image is two of the next."""
    scene = panel(8.0)
    on_panel = scene.labels == scene.labels[110, 160]
    assert on_panel.mean() > 0.05
    alone, found = (np.count_nonzero(np.diff(classes_at(detect(config, [scene] * 30), on_panel)))
                    for config in (ALONE, DEPTH))
    assert alone >= 10 and found <= share * alone


@pytest.mark.parametrize('config', [ALONE, replace(DEPTH, tracking=TrackingConfig(enabled=False))],
                         ids=['no memory', 'no tracking'])
def test_without_memory_or_tracking_each_image_has_its_own_classes(config):
    scene = panel(8.0)
    for k, one in enumerate(detections(config, [scene] * 4)):
        rng = np.random.default_rng(0)
        for _ in range(k + 1):
            depth_m = with_disparity_noise(scene.depth_m, 0.01, rng)
        if not config.segmentation.memory:
            alone = PlaneDetector(config).detect(scene.rgb, CAMERA, depth_m, scene.gravity_camera)
            assert one.planes.classes.tolist() == alone.planes.classes.tolist()
            assert one.planes.confidences.tolist() == alone.planes.confidences.tolist()
        else:
            fresh = classify_planes(one.planes, scene.gravity_camera.copy())
            is_plain = np.isin(one.planes.classes, (PlaneClass.WALL, PlaneClass.OTHER))
            assert is_plain.any()
            assert one.planes.classes[is_plain].tolist() == fresh[is_plain].tolist()


def test_what_was_switched_off_is_not_remembered():
    """Labels of planes that are not tracked are no labels of the same planes."""
    scene, found = panel(8.0), []
    untracked = replace(DEPTH, tracking=TrackingConfig(enabled=False))
    for config in (untracked, DEPTH):
        detector = PlaneDetector(untracked)
        detections(untracked, [scene] * 4, detector=detector)
        detector.config = config
        found += detections(config, [scene], start_s=0.2, detector=detector)
    one, other = (one.planes for one in found)
    assert one.confidences.tolist() == other.confidences.tolist()
    assert one.classes.tolist() == other.classes.tolist()


@pytest.mark.parametrize('how', ['reset', 'jump back in time'])
def test_a_new_epoch_has_no_history(how):
    detector, scene = PlaneDetector(DEPTH), panel(8.0)
    detections(DEPTH, [scene] * 4, start_s=10.0, detector=detector)
    if how == 'reset':
        detector.reset()
    found, = detections(DEPTH, [scene], start_s=10.2 if how == 'reset' else 1.0,
                        detector=detector)
    alone, = detections(DEPTH, [scene])
    assert found.planes.confidences.tolist() == alone.planes.confidences.tolist()
    assert found.planes.classes.tolist() == alone.planes.classes.tolist()
