# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""What users give the pipeline: it works, or a ValueError names it; the same for both calls."""

import re
import threading
from dataclasses import replace

import cv2
import numpy as np
import pytest
from threadpoolctl import threadpool_info

from plane_detector import CameraIntrinsics, PlaneDetector, segment_planes
from plane_detector._runtime.process import one_thread
from plane_detector.config import Config, DepthConfig
from plane_detector.depth.observation import DepthFunction
from plane_detector.evaluation.scenes.rooms import random_room
from plane_detector.geometry.projection import pixel_rays, ray_lengths

CAMERA = CameraIntrinsics(262.0, 262.0, 159.5, 119.5, 320, 240)
SCENE = random_room(np.random.default_rng(3), CAMERA)
RGB, SHAPE = SCENE.rgb, SCENE.depth_m.shape
DEPTH_M = (SCENE.depth_m + np.random.default_rng(0).normal(0, 0.001, SHAPE)).astype(np.float32)
TOPIC = Config(depth=DepthConfig(source='topic'))
DOWN = [0.0, 1.0, 0.0]


def detect(depth_m=DEPTH_M, rgb=RGB, camera=CAMERA, config=TOPIC, **given):
    return PlaneDetector(config).detect(rgb, camera, depth_m, **given)


def fixed(array):
    array = np.array(array)
    array.flags.writeable = False
    return array


def in_other_memory(array):
    """Return the same values as every second column of a wider array."""
    return np.repeat(array, 2, axis=1)[:, ::2]


LIKE_DEPTH = [fixed, in_other_memory, np.asfortranarray, lambda z: z.astype('>f4'),
              lambda z: z.astype(np.float64), lambda z: z.astype(np.longdouble),
              lambda z: z.tolist()]


@pytest.mark.parametrize('form', LIKE_DEPTH)
def test_depth_is_the_same_in_any_form(form):
    expected = segment_planes(DEPTH_M, CAMERA)
    assert len(expected.planes) >= 3
    np.testing.assert_array_equal(segment_planes(form(DEPTH_M), CAMERA).labels, expected.labels)
    np.testing.assert_array_equal(detect(form(DEPTH_M)).labels, expected.labels)


INVALID = [0.0, -1.0, np.inf, -np.inf, 5e-4, 1e30, 81.0]


@pytest.mark.parametrize('invalid', INVALID)
def test_every_invalid_value_is_as_nan_is(invalid):
    """In a mask of a third of the image, beside a range mark of equal values, as sensors give."""
    def image(value):
        depth_m = np.where(DEPTH_M > 4.0, np.float32(10.0), DEPTH_M)
        depth_m[:, :100] = value
        return depth_m
    expected = segment_planes(image(np.nan), CAMERA)
    assert len(expected.planes)
    for found in (segment_planes(image(invalid), CAMERA), detect(image(invalid))):
        np.testing.assert_array_equal(found.labels, expected.labels)
    masked = np.ma.masked_array(image(2.0), np.arange(SHAPE[1]) + np.zeros(SHAPE) < 100)
    np.testing.assert_array_equal(segment_planes(masked, CAMERA).labels, expected.labels)


@pytest.mark.parametrize(('distance_m', 'most_m', 'planes'), [
    (100.0, 80.0, 0), (100.0, 200.0, 1), (4.0, 3.0, 0), (2.0, 3.0, 1)])
def test_a_wall_beyond_the_largest_depth_is_none_for_both(distance_m, most_m, planes):
    config = Config(depth=DepthConfig(source='topic', max_depth=most_m))
    noise = np.random.default_rng(1).normal(0, 1e-4, SHAPE)
    wall_m = (1 / (1 / distance_m + noise / 100)).astype(np.float32)
    assert len(segment_planes(wall_m, CAMERA, config).planes) == planes
    assert len(detect(wall_m, config=config).planes) == planes


def test_distances_along_the_rays_are_converted():
    """Of a wide lens, whose corners are 1.9 times as far as they are deep."""
    camera = CameraIntrinsics(100.0, 100.0, 159.5, 119.5, 320, 240)
    depth_m = random_room(np.random.default_rng(3), camera).depth_m
    distance_m = depth_m * ray_lengths(camera)
    config = replace(TOPIC, depth=replace(TOPIC.depth, kind='ray'))
    expected = segment_planes(depth_m, camera)
    assert len(expected.planes) >= 3
    found = [segment_planes(distance_m, camera, config),
             PlaneDetector(config).detect(RGB, camera, distance_m)]
    for one in found:
        assert (one.labels == expected.labels).mean() > 0.98
        np.testing.assert_allclose(one.planes.normals[:3], expected.planes.normals[:3], atol=2e-3)
    np.testing.assert_allclose(found[1].depth_m, depth_m, rtol=1e-5)


MATRIX = np.array([[262, 0, 159.5], [0, 262, 119.5], [0, 0, 1]])


@pytest.mark.parametrize('kind', [np.float32, np.float64, np.float16])
def test_intrinsics_of_any_numbers(kind):
    k = MATRIX.astype(kind)
    camera = CameraIntrinsics(k[0, 0], k[1, 1], k[0, 2], k[1, 2], np.int32(320), np.float32(240))
    assert camera == CAMERA and all(type(one) in (int, float, bool)
                                    for one in vars(camera).values())
    np.testing.assert_array_equal(detect(camera=camera, gravity_camera=DOWN).labels,
                                  detect(gravity_camera=DOWN).labels)


@pytest.mark.parametrize('given', [
    {'gravity_camera': np.array([0, 9.8, 0], np.float32)}, {'gravity_camera': (0, 1, 0)},
    {'gravity_camera': fixed([0.0, 1e300, 0.0])}, {'gravity_camera': [0.0, 1e-300, 0.0]}])
def test_gravity_is_a_direction_of_any_length(given):
    np.testing.assert_allclose(detect(**given).gravity.gravity_camera, DOWN)


@pytest.mark.parametrize('given', [
    {'rgb': fixed(RGB)}, {'rgb': in_other_memory(RGB)}, {'covered': fixed(np.ones(SHAPE, bool))},
    {'covered': np.asfortranarray(np.ones(SHAPE, bool))}, {'camera_height_m': np.float32(1.5)},
    {'camera_height_m': np.array(1.5)}, {'stamp_s': np.float32(3.0)}])
def test_other_inputs_in_any_form(given):
    np.testing.assert_array_equal(detect(gravity_camera=DOWN, **given).labels,
                                  detect(gravity_camera=DOWN).labels)


WRONG = [
    ({'rgb': RGB[..., 0]}, r'\(240, 320\) uint8'), ({'rgb': RGB / 255}, 'float64'),
    ({'rgb': np.zeros((*SHAPE, 4), np.uint8)}, r'\(240, 320, 4\)'),
    ({'rgb': RGB[:-1]}, '320 x 239'), ({'rgb': None}, 'object'),
    ({'camera': MATRIX}, 'CameraIntrinsics, not ndarray'),
    ({'depth_m': (1e3 * DEPTH_M).astype(np.uint16)}, 'uint16.* divide by 1000'),
    ({'depth_m': DEPTH_M[None]}, '3-D float32'), ({'depth_m': DEPTH_M[:, :-1]}, '319 x 240'),
    ({'depth_m': DEPTH_M.astype(complex)}, 'complex128'),
    ({'covered': np.ones((1, 320), bool)}, r'\(1, 320\) bool'),
    ({'covered': np.ones(SHAPE, np.uint8)}, 'uint8: .* mask > 0'),
    ({'covered': True}, r'not \(\) bool'),
    ({'covered': np.ones(SHAPE[::-1], bool)}, r'\(320, 240\)'),
    ({'gravity_camera': [0, 1, 0, 0]}, r'\[0, 1, 0, 0\]'),
    ({'gravity_camera': [0, np.inf, 0]}, 'inf'), ({'gravity_camera': [0, np.nan, 0]}, 'nan'),
    ({'gravity_camera': np.zeros(3)}, 'not all 0'), ({'gravity_camera': 'down'}, "'down'"),
    ({'gravity_camera': 9.8}, '9.8'), ({'camera_height_m': np.nan}, 'camera_height_m nan'),
    ({'camera_height_m': -0.5}, 'camera_height_m -0.5'),
    ({'camera_height_m': np.float32(np.inf)}, 'inf'),
    ({'camera_height_m': [1.0, 2.0]}, r'\[1.0, 2.0\]'),
    ({'camera_height_m': np.array([1.0])}, r'array\(\[1.\]\)'), ({'camera_height_m': '1'}, "'1'"),
    ({'stamp_s': np.inf}, 'stamp_s must be finite'), ({'stamp_s': None}, 'stamp_s .* None'),
    ({'stamp_s': 'now'}, "stamp_s .* 'now'"),
    ({'stamp_s': [1.0, 2.0]}, r'stamp_s .* \[1.0, 2.0\]'),
    ({'config': {'depth': 'topic'}}, 'config .* not dict')]


@pytest.mark.parametrize(('given', 'named'), WRONG)
def test_what_cannot_be_used_is_named(given, named):
    with pytest.raises(ValueError, match=named):
        detect(**given)


@pytest.mark.parametrize(('given', 'named'), [
    ({'disparity_noise': np.nan}, 'nan'), ({'disparity_noise': -0.1}, '-0.1'),
    ({'disparity_noise': '.1'}, "disparity_noise .* '.1'"),
    ({'disparity_noise': None}, 'disparity_noise .* None'), ({'config': {}}, 'config .* not dict'),
    ({'rng': 3}, r'not 3: of a seed, np.random.default_rng\(seed\)'),
    ({'intrinsics': MATRIX}, 'CameraIntrinsics, not ndarray')])
def test_what_cannot_be_segmented_is_named(given, named):
    with pytest.raises(ValueError, match=named):
        segment_planes(**{'depth_m': DEPTH_M, 'intrinsics': CAMERA, **given})


@pytest.mark.parametrize(('given', 'named'), [
    ({'fx': '262'}, "fx .* not '262'"), ({'cy': None}, 'cy .* not None'),
    ({'width': 320.5}, 'width .* whole number of pixels, not 320.5'),
    ({'height': np.nan}, 'height .* nan'), ({'fx': np.float32(np.inf)}, 'must be finite')])
def test_numbers_that_are_no_camera_are_named(given, named):
    with pytest.raises(ValueError, match=named):
        replace(CAMERA, **given)


@pytest.mark.parametrize('angle_deg', [0.0, 180.0, -60.0, np.nan, '60', None])
def test_a_field_of_view_that_no_lens_has_is_named(angle_deg):
    with pytest.raises(ValueError, match=f'not {angle_deg!r}'):
        CameraIntrinsics.from_field_of_view(320, 240, angle_deg)


@pytest.mark.parametrize('model', [3, 'network.onnx'])
def test_what_is_no_depth_model_is_named(model):
    with pytest.raises(ValueError, match=f'depth model .* not {model!r}'):
        PlaneDetector(depth_model=model)


@pytest.mark.parametrize('form', LIKE_DEPTH)
@pytest.mark.parametrize('output', ['relative_disparity', 'disparity', 'metric_depth',
                                    'relative_depth'])
def test_a_function_may_return_its_depth_in_any_form(output, form):
    values = DEPTH_M if output in ('metric_depth', 'relative_depth') else 1 / DEPTH_M

    def found(values):
        model = DepthFunction(lambda rgb: values, output)
        return PlaneDetector(Config(), model).detect(RGB, CAMERA)
    expected = found(values)
    assert len(expected.planes)
    np.testing.assert_array_equal(found(form(values)).labels, expected.labels)


@pytest.mark.parametrize('invalid', [np.inf, -np.inf])
def test_an_infinite_relative_disparity_is_as_nan_is(invalid):
    def found(value):
        values = np.where(np.arange(320) < 90, np.float32(value), 1 / DEPTH_M)
        model = DepthFunction(lambda rgb: values, 'relative_disparity')
        return PlaneDetector(Config(), model).detect(RGB, CAMERA).labels
    np.testing.assert_array_equal(found(invalid), found(np.nan))


def threads():
    return [cv2.getNumThreads(), *(one['num_threads'] for one in threadpool_info())]


def test_a_call_uses_one_thread_and_leaves_those_of_the_process(monkeypatch):
    """Also where two calls overlap and the first to begin ends first."""
    before_cv2 = cv2.getNumThreads()
    detect()  # all libraries are loaded
    has_begun, may_end, seen = threading.Event(), threading.Event(), []

    def other():
        with one_thread():
            has_begun.set()
            may_end.wait(10)
    thread = threading.Thread(target=other)
    try:
        cv2.setNumThreads(3)
        before = threads()
        with one_thread():
            thread.start()
            assert has_begun.wait(10)
            with one_thread():
                seen.append(threads())
            seen.append(threads())
        may_end.set()
        thread.join()
        assert set(seen[0]) == set(seen[1]) == {1}
        assert threads() == before and before[0] == 3
        monkeypatch.setattr('plane_detector.pipeline._find_regions',
                            lambda *_, **__: seen.append(threads()) or 1 / 0)
        for call in (detect, lambda: segment_planes(DEPTH_M, CAMERA)):
            with pytest.raises(ZeroDivisionError):
                call()
            assert seen[-1][0] == 1 and threads() == before
    finally:
        cv2.setNumThreads(before_cv2)


FULL = CameraIntrinsics(1200.0, 1200.0, 640.0, 360.0, 1280, 720)


@pytest.mark.parametrize(('factor', 'side', 'said'), [
    (0.5, 1, 'about a 640 x 360 image.* multiply them by 2.00'),
    (1 / 3, 1, '427 x 240 .* by 3.00'),
    (2 / 3, 1, '853 x 480 image.* by 1.5'), (1, 0.5, '1280 x 72. image.* by 0.50')])
def test_the_matrix_of_another_size_is_asked_about(factor, side, said):
    """K of a binned image with the full size, and that of the full one with a small image."""
    camera = CameraIntrinsics(*(factor * value for value in (FULL.fx, FULL.fy, FULL.cx, FULL.cy)),
                              round(side * FULL.width), round(side * FULL.height))
    assert re.search(said, camera.question)
    assert f'{camera.cx:.0f}, {camera.cy:.0f}' in camera.question


def test_it_is_in_the_note_of_the_image():
    camera = replace(CAMERA, cx=79.75, cy=59.75)
    found = detect(camera=camera)
    assert found.input_note == camera.question != ''


@pytest.mark.parametrize(('cx', 'cy', 'is_asked'), [
    (0.5, 0.5, False), (0.57, 0.46, False), (0.4, 0.6, False), (0.5, 0.8, True),
    (0.3, 0.5, True), (-0.2, 0.5, True)])
def test_a_principal_point_is_asked_about_only_far_off_the_middle(cx, cy, is_asked):
    camera = replace(FULL, cx=cx * FULL.width, cy=cy * FULL.height)
    assert bool(camera.question) == is_asked
    assert not is_asked or 'cropped' in camera.question
    assert not replace(camera, is_guessed=True).question


@pytest.mark.parametrize('down', [[0, -1, 0], [0.0, -0.9, -0.4], [0.3, -0.8, -0.5]])
def test_measured_gravity_with_the_sign_turned_is_asked_about(down):
    true_down = -np.array(down, float) / np.linalg.norm(down)
    ray_x, ray_y = pixel_rays(CAMERA)
    with np.errstate(divide='ignore'):
        height_of_ray = np.add.outer(ray_y * true_down[1] + true_down[2], ray_x * true_down[0])
        floor_m = np.where(height_of_ray > 0.12, 0.9 / height_of_ray, np.nan)
    floor_m += np.random.default_rng(0).normal(0, 0.001, SHAPE) * floor_m**2
    assert 'REP-145' in detect(floor_m, gravity_camera=down).input_note
    assert detect(floor_m, gravity_camera=true_down).input_note == ''


def test_programs_of_earlier_versions_find_the_results_of_the_ground():
    found = detect(gravity_camera=DOWN, camera_height_m=1.5)
    result = found.ground_result
    assert found.ground_pixels is result and found.heights_m is result.heights_m
    assert found.heights_m.shape == SHAPE
    assert found.drop_depths_m.shape == found.drops_m.shape[:1]
    assert found.drop_note == result.drop_note and found.mounting == result.mounting
    assert found.scale_note.startswith(found.scale.note)
    assert replace(found, input_note='of rays').scale_note.endswith('of rays')
