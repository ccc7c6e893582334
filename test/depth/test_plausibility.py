# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Outputs that cannot be depth are refused with a reason, at configure or at a frame."""

import needs_onnxruntime  # noqa: F401
import numpy as np
import pytest
from onnx_models import PLAIN, constant, write_depth_network, write_network

from plane_detector.config import DepthConfig
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.depth.plausibility import CORRIDOR_LENS, ImplausibleDepthError, corridor
from plane_detector.geometry.projection import pixel_rays

onnx = pytest.importorskip('onnx', reason='onnx, of the extra "test", is not installed')
helper, FLOAT = onnx.helper, onnx.TensorProto.FLOAT


def load(path, output='metric_depth'):
    return DepthEstimator(DepthConfig(model=str(path), output=output, **PLAIN))


@pytest.mark.parametrize(('weights', 'bias', 'said'), [
    ((0, 0, 0), 0, r'zero everywhere \(0 to 0\)'),
    ((0, 0, 0), 2.5, r'2\.5 everywhere'),
    ((-1, 0, 0), 0, r'nowhere positive \(-0\.'),
    ((1, 0, 0), np.nan, 'nowhere finite'),
    ((1, 0, 0), np.inf, 'nowhere finite'),
    ((10, 0, 0), -3, r'\d\d% of its output is negative \(down to -')])
def test_a_network_that_gives_no_depth_is_refused_at_configure(tmp_path, weights, bias, said):
    path = write_depth_network(tmp_path / 'n.onnx', height=48, width=64, weights=(*weights, bias))
    with pytest.raises(ImplausibleDepthError, match=rf'n\.onnx: .*{said}'):
        load(path)


def test_negative_values_are_a_fault_of_metres_only(tmp_path):
    path = write_depth_network(tmp_path / 'n.onnx', height=48, width=64, weights=(10, 0, 0, -3))
    estimate = load(path, 'relative_disparity')
    rgb = np.zeros((48, 64, 3), np.uint8)
    rgb[:, 32:, 0] = 255
    found = estimate(rgb)
    assert np.isnan(found[:, :30]).all()
    np.testing.assert_allclose(found[:, 34:], 7, rtol=1e-5)


def test_a_frame_without_depth_is_skipped_and_the_next_is_not(tmp_path):
    path = write_depth_network(tmp_path / 'n.onnx', height=48, width=64, weights=(1, 0, 0))
    estimate = load(path)
    rgb = np.zeros((48, 64, 3), np.uint8)
    rgb[::2, :, 2] = 255
    with pytest.raises(ImplausibleDepthError, match=r'n\.onnx: its output is zero everywhere'):
        estimate(rgb)
    rgb[..., 0] = 255
    with pytest.raises(ImplausibleDepthError, match=r'n\.onnx: its output is 1 everywhere'):
        estimate(rgb)
    rgb[:20, :, 0] = 51
    np.testing.assert_allclose(estimate(rgb)[[5, 40]], [[0.2], [1]] * np.ones((1, 64)), rtol=1e-5)


def test_every_pixel_of_the_corridor_is_on_a_face_and_brightness_shows_no_distance():
    rgb, z_m = corridor()
    ray_x, ray_y = pixel_rays(CORRIDOR_LENS)
    x_m, y_m = ray_x * z_m, ray_y[:, None] * z_m
    off_m = np.abs([x_m + 1.5, x_m - 1.5, y_m + 1.4, y_m - 1.2, z_m - 8]).min(axis=0)
    assert off_m.max() < 1e-5
    for limits in ((x_m, -1.5, 1.5), (y_m, -1.4, 1.2), (z_m, 1.2, 8.0)):
        values, low, high = limits
        assert low - 1e-5 < values.min() and values.max() < high + 1e-5
    assert abs(np.corrcoef(rgb[..., 0].ravel(), z_m.ravel())[0, 1]) < 0.1


def write_corridor_network(path, *, disparity):
    """Write a network that sees a corridor in any image, a little of the image added."""
    truth_m = corridor()[1]
    shape = np.float32(1 / truth_m if disparity else truth_m)
    nodes = [helper.make_node('ReduceMean', ['image'], ['grey'], axes=[1], keepdims=1),
             helper.make_node('Mul', ['grey', 'little'], ['ripple']),
             helper.make_node('Add', ['ripple', 'corridor'], ['depth'])]
    height, width = shape.shape
    return write_network(
        path, nodes, [('image', FLOAT, [1, 3, height, width])],
        [('depth', FLOAT, [1, 1, height, width])],
        [constant('corridor', shape[None, None]), constant('little', 0.01)])


@pytest.mark.parametrize(('gives_disparity', 'output', 'said'), [
    (True, 'metric_depth', r'declared as metric_depth, but its output falls with distance'),
    (False, 'disparity', r'declared as disparity, but its output rises with distance'),
    (False, 'relative_disparity', r'it seems to be depth'),
    (True, 'disparity', ''), (True, 'relative_disparity', ''), (False, 'metric_depth', '')])
def test_depth_called_disparity_and_disparity_called_depth_are_refused(
        tmp_path, gives_disparity, output, said):
    path = write_corridor_network(tmp_path / 'n.onnx', disparity=gives_disparity)
    if not said:
        assert load(path, output).output == output
        return
    with pytest.raises(ImplausibleDepthError, match=rf'n\.onnx: .*{said}'):
        load(path, output)


def test_a_network_that_sees_only_colours_is_not_judged_by_a_grey_corridor(tmp_path):
    path = write_depth_network(tmp_path / 'n.onnx', height=480, width=640, weights=(1, 0, 0, 0.1))
    for output in ('metric_depth', 'disparity'):
        assert load(path, output).output == output
