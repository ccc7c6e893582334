# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""When a picture is rectified, by which matrices, and how its depth is fitted to it."""

import cv2
import numpy as np
import pytest
from ros_helpers import camera_info_msg, header, image_msg
from sensor_msgs.msg import CompressedImage

from plane_detector.config import NodeConfig
from plane_detector.ros.inputs import frame_conversion as conversion
from plane_detector.ros.inputs.frame_conversion import PictureConverter, is_rectified_name
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
    return PictureConverter(topic).convert(a_frame, NodeConfig(rectify=rectify))


@pytest.mark.parametrize('topic, rectified', [
    ('/camera/image_raw', False), ('/camera/image_color', False), ('/camera/image_rect', True),
    ('/camera/image_rect_color', True), ('/camera/image_rect_color/compressed', True),
    ('/zed/rgb/color/rect/image', True), ('/camera/image_rectified', True),
    ('/rect/front/camera/image_raw', False), ('/direct/image', False)])
def test_names_of_rectified_topics(topic, rectified):
    assert is_rectified_name(topic) == rectified


@pytest.mark.parametrize('model', DISTORTION)
def test_auto_rectifies_a_distorted_picture(model):
    picture = convert(frame(DISTORTION[model], model))
    assert picture.intrinsics == NEW
    assert (picture.rgb != RGB).any()


@pytest.mark.parametrize('d', [(), (0.0,) * 5])
def test_auto_leaves_a_picture_without_distortion(d):
    picture = convert(frame(d))
    assert picture.intrinsics == CAMERA
    np.testing.assert_array_equal(picture.rgb, RGB)


@pytest.mark.parametrize('binning', [1, 2])
def test_a_calibration_without_size_has_that_of_the_image(binning):
    bare = frame()
    bare.camera_info.width = bare.camera_info.height = 0
    bare.camera_info.binning_x = bare.camera_info.binning_y = binning
    picture = convert(bare)
    assert (picture.intrinsics.width, picture.intrinsics.height) == (80, 60)
    assert picture.intrinsics.fx == CAMERA.fx / binning
    assert bare.camera_info.width == 0, 'the message is not changed'


def test_auto_leaves_a_picture_that_is_rectified_already():
    picture = convert(frame(DISTORTION['plumb_bob']), topic='/camera/image_rect')
    assert picture.intrinsics == NEW
    np.testing.assert_array_equal(picture.rgb, RGB)


def test_rectifying_can_be_switched_off_and_forced():
    distorted = frame(DISTORTION['plumb_bob'])
    off = convert(distorted, rectify='false')
    assert off.intrinsics == CAMERA
    np.testing.assert_array_equal(off.rgb, RGB)
    forced = convert(frame(), rectify='true')
    assert forced.intrinsics == NEW
    assert (forced.rgb != RGB).any()


def test_maps_are_computed_once_per_calibration(monkeypatch):
    made = []

    def make(*arguments, original=conversion.make_rectification):
        made.append(arguments)
        return original(*arguments)

    monkeypatch.setattr(conversion, 'make_rectification', make)
    converter = PictureConverter('image')
    first, other = frame(DISTORTION['plumb_bob']), frame([-0.1, 0.0, 0.0, 0.0, 0.0])
    for each in (first, first, other, other):
        converter.convert(each, NodeConfig())
    assert len(made) == 2


def test_a_cropped_and_binned_distorted_picture_is_that_part_of_the_whole():
    """Rectifying the sent part gives what the part of the rectified whole is."""
    whole = frame(DISTORTION['plumb_bob'])
    smooth = cv2.GaussianBlur(RGB, (0, 0), 4)
    whole = Frame(image_msg(smooth, 'rgb8'), whole.camera_info, None, None, 0)
    expected = convert(whole)
    part = frame(DISTORTION['plumb_bob'])
    roi = part.camera_info.roi
    roi.x_offset, roi.y_offset, roi.width, roi.height = 20, 10, 40, 30
    part = Frame(image_msg(smooth[10:40, 20:60], 'rgb8'), part.camera_info, None, None, 0)
    picture = convert(part)
    assert (picture.intrinsics.cx, picture.intrinsics.cy) == (NEW.cx - 20, NEW.cy - 10)
    error = np.abs(picture.rgb.astype(int) - expected.rgb[10:40, 20:60])
    assert error[5:-5, 5:-5].max() <= 1


def test_an_unknown_lens_model_is_refused():
    with pytest.raises(ValueError, match='double_sphere'):
        convert(frame([0.1, 0.2], 'double_sphere'))


def test_a_picture_of_another_size_than_its_calibration_is_refused():
    wrong = frame()
    wrong.camera_info.width = 100
    with pytest.raises(ValueError, match='80 x 60, its CameraInfo is for 100 x 60'):
        convert(wrong)


def test_compressed_pictures_are_decoded():
    _, data = cv2.imencode('.png', RGB[..., ::-1])
    image = CompressedImage(header=header(), format='png', data=data.tobytes())
    picture = convert(Frame(image, frame().camera_info, None, None, 0))
    np.testing.assert_array_equal(picture.rgb, RGB)


@pytest.mark.parametrize('shape', [(60, 80), (30, 40), (120, 160), (45, 60)])
def test_depth_of_the_same_view_is_brought_to_the_picture(shape):
    picture = convert(frame(depth=np.full(shape, 2.0, np.float32)))
    np.testing.assert_allclose(picture.depth_m, np.full((60, 80), 2.0), rtol=1e-6)


def test_depth_of_another_view_is_refused():
    with pytest.raises(ValueError, match='registered'):
        convert(frame(depth=np.ones((60, 60), np.float32)))


def test_depth_is_rectified_with_its_picture():
    depth_m = np.full((60, 80), 2.0, np.float32)
    depth_m[:, 40:] = 5.0
    picture = convert(frame(DISTORTION['plumb_bob'], depth=depth_m))
    values = picture.depth_m[np.isfinite(picture.depth_m)]
    np.testing.assert_allclose(np.unique(values.round(5)), [2.0, 5.0])
