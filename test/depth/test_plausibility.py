# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Outputs that cannot be depth are refused with a reason, at configure or at a frame."""

import numpy as np
import pytest
from onnx_models import PLAIN, write_depth_network, write_network

from plane_detector.config import DepthConfig
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.depth.plausibility import ImplausibleDepthError, corridor

onnx = pytest.importorskip('onnx', reason='onnx, of the extra "test", is not installed')
helper, numpy_helper, FLOAT = onnx.helper, onnx.numpy_helper, onnx.TensorProto.FLOAT


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


def test_one_colour_may_have_one_depth(tmp_path):
    path = write_depth_network(tmp_path / 'n.onnx', height=48, width=64, weights=(1, 0, 0))
    found = load(path)(np.full((48, 64, 3), 51, np.uint8))
    np.testing.assert_allclose(found, 0.2, rtol=1e-5)


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
        [numpy_helper.from_array(shape[None, None], 'corridor'),
         numpy_helper.from_array(np.float32(0.01), 'little')])


@pytest.mark.parametrize(('gives_disparity', 'output', 'said'), [
    (True, 'metric_depth', r'declared as metric_depth, but its output falls with distance'),
    (False, 'disparity', r'declared as disparity, but its output rises with distance'),
    (False, 'relative_disparity', r'it seems to be depth')])
def test_depth_called_disparity_and_disparity_called_depth_are_refused(
        tmp_path, gives_disparity, output, said):
    path = write_corridor_network(tmp_path / 'n.onnx', disparity=gives_disparity)
    with pytest.raises(ImplausibleDepthError, match=rf'n\.onnx: .*{said}'):
        load(path, output)


@pytest.mark.parametrize(('gives_disparity', 'output'), [
    (True, 'disparity'), (True, 'relative_disparity'), (False, 'metric_depth')])
def test_correctly_declared_outputs_are_accepted(tmp_path, gives_disparity, output):
    path = write_corridor_network(tmp_path / 'n.onnx', disparity=gives_disparity)
    assert load(path, output).output == output


def test_a_network_that_depends_only_on_colour_is_not_judged(tmp_path):
    for weights in ((1, 0, 0), (0, 1, 3)):
        path = write_depth_network(tmp_path / 'n.onnx', height=480, width=640, weights=weights)
        for output in ('metric_depth', 'disparity', 'relative_disparity'):
            assert load(path, output).output == output


def sequence_network(path):
    nodes = [helper.make_node('SequenceConstruct', ['image'], ['depth'])]
    graph = helper.make_graph(
        nodes, 'test', [helper.make_tensor_value_info('image', FLOAT, [1, 3, 8, 8])],
        [helper.make_tensor_sequence_value_info('depth', FLOAT, [1, 3, 8, 8])])
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid('', 13)],
                                ir_version=8), str(path))
    return path


def string_network(path):
    return write_network(path, [helper.make_node('Cast', ['image'], ['depth'],
                                                 to=onnx.TensorProto.STRING)],
                         [('image', FLOAT, [1, 3, 8, 8])],
                         [('depth', onnx.TensorProto.STRING, [1, 3, 8, 8])])


def empty_network(path):
    return write_network(
        path, [helper.make_node('Slice', ['image', 'end', 'end', 'axis'], ['depth'])],
        [('image', FLOAT, [1, 3, 8, 8])], [('depth', FLOAT, [1, 3, 0, 8])],
        [numpy_helper.from_array(np.array([0]), 'end'),
         numpy_helper.from_array(np.array([2]), 'axis')])


def seen_empty_network(path):
    """Write a network whose output turns out to be empty when it runs."""
    nodes = [helper.make_node('ReduceMin', ['image'], ['least'], axes=[0, 1, 2, 3], keepdims=0),
             helper.make_node('Sub', ['least', 'least'], ['nothing']),
             helper.make_node('Cast', ['nothing'], ['zero'], to=onnx.TensorProto.INT64),
             helper.make_node('Reshape', ['zero', 'one'], ['end']),
             helper.make_node('Slice', ['image', 'first', 'end', 'axis'], ['depth'])]
    return write_network(
        path, nodes, [('image', FLOAT, [1, 3, 8, 8])], [('depth', FLOAT, [1, 3, 'h', 8])],
        [numpy_helper.from_array(np.array([value]), name)
         for name, value in (('one', 1), ('first', 0), ('axis', 2))])


@pytest.mark.parametrize(('write', 'said'), [
    (sequence_network, 'output depth must be a tensor of numbers'),
    (string_network, 'output depth must be a tensor of numbers'),
    (empty_network, 'output depth is empty'),
    (seen_empty_network, r'output depth is \(1, 3, 0, 8\), which is empty')])
def test_non_numeric_or_empty_outputs_are_refused_at_configure(
        tmp_path, write, said):
    with pytest.raises(ValueError, match=rf'n\.onnx does not fit: .*{said}.*inputs: image'):
        load(write(tmp_path / 'n.onnx'))


def test_the_corridor_has_one_grey_at_all_distances():
    rgb, depth_m = corridor()
    near_to_far = np.argsort(depth_m[::4, ::4].ravel())
    greys = rgb[::4, ::4, 0].ravel()[near_to_far].astype(float)
    means = [part.mean() for part in np.array_split(greys, 8)]
    assert np.ptp(means) < 8
    assert depth_m.min() > 1
    assert depth_m.max() == 8
