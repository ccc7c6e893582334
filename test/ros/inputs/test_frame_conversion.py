# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Rectification of images, its matrices, and resizing of depth."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from field_faults import changed
from ros_helpers import camera_info_msg, image_msg

from plane_detector.config import NodeConfig
from plane_detector.ros.inputs.frame_conversion import (
    FrameConverter,
    _fit_depth,
    is_rectified_name,
)
from plane_detector.ros.inputs.synchronizer import Frame
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(60.0, 62.0, 39.5, 29.5, 80, 60)
NEW = CameraIntrinsics(50.0, 51.0, 38.0, 31.0, 80, 60)
DISTORTION = {'plumb_bob': [-0.2, 0.05, 0.0, 0.0, 0.0],
              'rational_polynomial': [0.2, 0.05, 0.0, 0.0, 0.0, 0.4, 0.1, 0.0],
              'equidistant': [-0.02, 0.01, 0.0, 0.0]}
RGB = np.random.default_rng(0).integers(0, 256, (60, 80, 3), np.uint8)


def frame(distortion=(), model='plumb_bob', depth=None):
    info = camera_info_msg(CAMERA)
    info.d, info.distortion_model = list(distortion), model
    info.p = [NEW.fx, 0.0, NEW.cx, 0.0, 0.0, NEW.fy, NEW.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    depth_msg = None if depth is None else image_msg(depth, '32FC1')
    return Frame(image_msg(RGB, 'rgb8'), info, depth_msg, None, 0)


def convert(a_frame, topic='/camera/image_raw', rectify='auto'):
    return FrameConverter(topic).convert(a_frame, NodeConfig(rectify=rectify))


@pytest.mark.parametrize('topic, rectified', [
    ('/camera/image_raw', False), ('/camera/image_color', False), ('/camera/image_rect', True),
    ('/camera/image_rect_color', True), ('/camera/image_rect_color/compressed', True),
    ('/zed/rgb/color/rect/image', True), ('/camera/image_rectified', True),
    ('/rect/front/camera/image_raw', False), ('/direct/image', False)])
def test_names_of_rectified_topics(topic, rectified):
    assert is_rectified_name(topic) == rectified


@pytest.mark.parametrize('model', DISTORTION)
def test_auto_rectifies_a_distorted_image(model):
    image = convert(frame(DISTORTION[model], model))
    assert image.intrinsics == NEW
    assert (image.rgb != RGB).any()


@pytest.mark.parametrize('name', ['fisheye', 'kannala_brandt4'])
def test_models_under_other_names(name):
    image = convert(frame(DISTORTION['equidistant'], name))
    expected = convert(frame(DISTORTION['equidistant'], 'equidistant'))
    np.testing.assert_array_equal(image.rgb, expected.rgb)
    left = convert(frame(DISTORTION['equidistant'], name), rectify='false')
    assert left.distortion.model == 'equidistant', 'as consumers of ~/camera_info know it'


# Those that gave nonsense, with warnings of numpy, when each field had each extreme value.
ODD = [*((f'r.{k}', value) for k in range(9) for value in (1e-308, 1e-38, 1e38, np.inf, np.nan)),
       ('r.8', 0.0), *((name, np.full(9, value)) for name in ('k', 'r')
                       for value in (np.inf, 1e308, 1e-308, 1e-38))]


@pytest.mark.parametrize('path, value', ODD)
@pytest.mark.filterwarnings('error')
def test_a_calibration_with_one_odd_field_is_refused(path, value):
    bent = frame(DISTORTION['plumb_bob'])
    info = changed(bent.camera_info, path, value)
    if path.startswith('r.') and int(path[2:]) % 4 and abs(value) < 1:
        convert(replace(bent, camera_info=info))  # as good as the zero that it replaces
        return
    with pytest.raises(ValueError, match='not a rotation|must be finite|cannot be that'):
        convert(replace(bent, camera_info=info))


@pytest.mark.parametrize('path', ['p.8', 'p.9', 'p.10', 'k.6', 'k.7', 'k.8', 'k.1', 'p.1'])
@pytest.mark.filterwarnings('error')
def test_numbers_that_a_pinhole_camera_has_not_have_no_effect(path):
    bent = frame(DISTORTION['plumb_bob'])
    expected = convert(bent)
    for value in (0.0, np.inf, np.nan, 1e308, 1e-308):
        image = convert(replace(bent, camera_info=changed(bent.camera_info, path, value)))
        np.testing.assert_array_equal(image.rgb, expected.rgb)


@pytest.mark.parametrize('d', [(), (0.0,) * 5])
def test_auto_leaves_an_image_without_distortion(d):
    image = convert(frame(d))
    assert image.intrinsics == CAMERA
    np.testing.assert_array_equal(image.rgb, RGB)


def test_rectifying_can_be_switched_off_and_forced():
    distorted = frame(DISTORTION['plumb_bob'])
    off = convert(distorted, rectify='false')
    assert off.intrinsics == CAMERA
    np.testing.assert_array_equal(off.rgb, RGB)
    forced = convert(frame(), rectify='true')
    assert forced.intrinsics == NEW
    assert (forced.rgb != RGB).any()


def test_a_cropped_and_binned_distorted_image_is_that_part_of_the_whole():
    """Rectifying the sent part gives what the part of the rectified whole is."""
    whole = frame(DISTORTION['plumb_bob'])
    smooth = cv2.GaussianBlur(RGB, (0, 0), 4)
    whole = Frame(image_msg(smooth, 'rgb8'), whole.camera_info, None, None, 0)
    expected = convert(whole)
    part = frame(DISTORTION['plumb_bob'])
    roi = part.camera_info.roi
    roi.x_offset, roi.y_offset, roi.width, roi.height = 20, 10, 40, 30
    part = Frame(image_msg(smooth[10:40, 20:60], 'rgb8'), part.camera_info, None, None, 0)
    image = convert(part)
    assert (image.intrinsics.cx, image.intrinsics.cy) == (NEW.cx - 20, NEW.cy - 10)
    error = np.abs(image.rgb.astype(int) - expected.rgb[10:40, 20:60])
    assert error[5:-5, 5:-5].max() <= 1


def test_a_rectified_camera_is_turned_as_r_says():
    """As those of a stereo pair: R maps rays of the camera to those of the rectified one."""
    turned, (u, v) = frame(), (30, 20)
    rotation, _ = cv2.Rodrigues(np.radians([2.0, -5.0, 4.0]))
    turned.camera_info.r = rotation.ravel().tolist()
    dot = np.zeros_like(RGB)
    dot[v - 1:v + 2, u - 1:u + 2] = 200
    image = convert(replace(turned, image=image_msg(dot, 'rgb8')), rectify='true')
    ray = rotation @ [(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, 1.0]
    seen = np.average(np.indices(RGB.shape[:2]).reshape(2, -1), axis=1,
                      weights=image.rgb[..., 0].ravel())[::-1]
    np.testing.assert_allclose(seen, (NEW.fx * ray[0] / ray[2] + NEW.cx,
                                      NEW.fy * ray[1] / ray[2] + NEW.cy), atol=0.1)


@pytest.mark.parametrize('binning', [0, 2])
def test_a_calibration_without_a_size_has_that_of_the_image(binning):
    unsized = frame()
    info = unsized.camera_info
    info.width = info.height = 0
    info.binning_x = info.binning_y = binning
    found = convert(unsized).intrinsics
    assert (found.width, found.height, found.fx) == (80, 60, CAMERA.fx / max(binning, 1))


@pytest.mark.parametrize('shape', [(60, 80), (30, 40), (120, 160), (45, 60)])
def test_depth_with_the_same_view_is_resized_to_the_image(shape):
    image = convert(frame(depth=np.full(shape, 2.0, np.float32)))
    np.testing.assert_allclose(image.depth_m, np.full((60, 80), 2.0), rtol=1e-6)


def test_a_plane_in_depth_of_another_size_stays_a_plane():
    """The disparity of a plane is linear in the image, its depth is not."""
    def plane_m(width, height):
        column = (np.arange(width, dtype=np.float32) + 0.5) / width
        return np.tile(1 / (0.2 + 0.5 * column), (height, 1))
    image = convert(frame(depth=plane_m(40, 30)))
    np.testing.assert_allclose(image.depth_m[:, 2:-2], plane_m(80, 60)[:, 2:-2], rtol=2e-5)


def test_depth_that_says_next_to_nothing_of_the_image_is_refused():
    with pytest.raises(ValueError, match='2 x 1, over 32 times smaller than the 80 x 40 image'):
        _fit_depth(np.ones((1, 2), np.float32), CameraIntrinsics(60.0, 60.0, 39.5, 19.5, 80, 40))
    phone = CameraIntrinsics(60.0, 60.0, 39.5, 19.5, 64, 48)
    assert _fit_depth(np.ones((3, 4), np.float32), phone).shape == (48, 64)


def test_an_image_of_too_many_pixels_is_refused_with_the_parameter():
    with pytest.raises(ValueError, match='is 80 x 60, more than max_image_pixels, 4799: .*raise'):
        FrameConverter('image_raw').convert(frame(), NodeConfig(max_image_pixels=4799))
    assert FrameConverter('image_raw').convert(frame(), NodeConfig(max_image_pixels=4800))


def test_depth_is_rectified_with_its_image():
    depth_m = np.full((60, 80), 2.0, np.float32)
    depth_m[:, 60:] = 5.0
    bright = np.repeat((40 * depth_m)[..., None], 3, axis=2).astype(np.uint8)
    image = convert(replace(frame(DISTORTION['plumb_bob'], depth=depth_m),
                            image=image_msg(bright, 'rgb8')))
    is_valid = np.isfinite(image.depth_m)
    values = image.depth_m[is_valid]
    np.testing.assert_allclose(np.unique(values.round(5)), [2.0, 5.0])
    assert np.mean((values > 3) == (image.rgb[is_valid, 0] > 140)) > 0.99


@pytest.mark.parametrize('distortion', [(), (-0.2, 0.05, 0.0, 0.0, 0.0)])
def test_a_large_image_is_reduced_first_with_its_depth_and_camera(distortion):
    """The reduced image is the whole one made smaller, whether it is rectified or not."""
    depth = np.linspace(1, 2, 80, dtype=np.float32)[None].repeat(60, axis=0)
    converter = FrameConverter('image_raw')
    whole, small = (converter.convert(frame(distortion, depth=depth), NodeConfig(max_side=side))
                    for side in (0, 40))
    assert small.rgb.shape == (30, 40, 3)
    assert small.depth_m.shape == (30, 40)
    ours, theirs = small.intrinsics, whole.intrinsics
    assert (ours.width, ours.height) == (40, 30)
    assert ours.fx == theirs.fx / 2
    assert ours.cx == (theirs.cx + 0.5) / 2 - 0.5
    expected = whole.rgb.reshape(30, 2, 40, 2, 3).mean(axis=(1, 3))
    inside = np.s_[5:25, 5:35]
    assert np.abs(small.rgb[inside] - expected[inside]).mean() < (30 if distortion else 1)
    expected_m = whole.depth_m.reshape(30, 2, 40, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(small.depth_m[inside], expected_m[inside], atol=0.03)


@pytest.mark.parametrize('rectify', ['auto', 'true', 'false'])
@pytest.mark.parametrize('max_side', [0, 40])
def test_a_guessed_lens_stays_one(rectify, max_side):
    """Of the image as it comes, rectified, and reduced."""
    for is_guessed in (False, True):
        settings = NodeConfig(rectify=rectify, max_side=max_side, lens_is_guessed=is_guessed)
        found = FrameConverter('/camera/image').convert(frame(DISTORTION['plumb_bob']), settings)
        assert found.intrinsics.is_guessed == is_guessed
