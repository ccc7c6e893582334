# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""External files that an ONNX file may refer to."""

import needs_onnxruntime  # noqa: F401
import numpy as np
import pytest
from onnx_models import PLAIN, write_depth_network

from plane_detector.config import DepthConfig
from plane_detector.depth import onnx_file
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.depth.onnx_file import check_file, read_contents

onnx = pytest.importorskip('onnx', reason='onnx, of the extra "test", is not installed')
helper, numpy_helper, FLOAT = onnx.helper, onnx.numpy_helper, onnx.TensorProto.FLOAT


def external(location, offset=0, shape=(1, 3, 1, 1)):
    """Return a tensor whose numbers lie in another file."""
    tensor = onnx.TensorProto(name='kernel', data_type=FLOAT, dims=shape,
                              data_location=onnx.TensorProto.EXTERNAL)
    for key, value in (('location', location), ('offset', str(offset)), ('length', '12')):
        tensor.external_data.add(key=key, value=value)
    return tensor


def write_with(path, location):
    """Write a network R + 2 G + 4 B whose kernel lies at a location."""
    graph = helper.make_graph(
        [helper.make_node('Conv', ['image', 'kernel'], ['depth'])], 'test',
        [helper.make_tensor_value_info('image', FLOAT, [1, 3, 4, 4])],
        [helper.make_tensor_value_info('depth', FLOAT, [1, 1, 4, 4])], [external(location)])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid('', 13)], ir_version=8)
    path.write_bytes(model.SerializeToString())
    return path


def kernel(folder, name='weights.bin'):
    (folder / name).write_bytes(np.float32([1, 2, 4]).tobytes())


def depth_of_white(path):
    estimate = DepthEstimator(DepthConfig(model=str(path), output='metric_depth', **PLAIN))
    return estimate(np.full((4, 4, 3), 255, np.uint8))


def test_weights_beside_the_file_or_beside_the_target_of_a_link_are_read(tmp_path):
    kernel(tmp_path)
    np.testing.assert_allclose(depth_of_white(write_with(tmp_path / 'n.onnx', 'weights.bin')), 7)
    for folder in ('blobs', 'snapshot'):  # as the cache of Hugging Face lays its files out
        (tmp_path / folder).mkdir()
    kernel(tmp_path / 'blobs', 'ab12')
    write_with(tmp_path / 'blobs' / 'cd34', 'weights.bin')
    (tmp_path / 'snapshot' / 'n.onnx').symlink_to('../blobs/cd34')
    (tmp_path / 'snapshot' / 'weights.bin').symlink_to('../blobs/ab12')
    np.testing.assert_allclose(depth_of_white(tmp_path / 'snapshot' / 'n.onnx'), 7)


@pytest.mark.parametrize('location', [
    '../secret', '{folder}/secret', 'sub/../../secret', 'link', 'missing', '.', '', 'pipe',
    '*/_ORT_MEM_ADDR_/*', 'zero\0byte', 'x' * 5000])
def test_other_files_are_not_opened(tmp_path, location, monkeypatch):
    folder = tmp_path / 'model'
    (folder / '*' / '_ORT_MEM_ADDR_').mkdir(parents=True)
    kernel(folder / '*' / '_ORT_MEM_ADDR_', '*')
    kernel(tmp_path, 'secret')
    (folder / 'link').symlink_to('../secret')
    onnx_file.os.mkfifo(folder / 'pipe')
    path = write_with(folder / 'n.onnx', location.format(folder=tmp_path))
    monkeypatch.setattr('onnxruntime.InferenceSession', lambda *_, **__: pytest.fail('loaded'))
    with pytest.raises(ValueError, match=r'n\.onnx keeps its weights in .* is not loaded'):
        depth_of_white(path)


def everywhere():
    """Return a model with external data at every place that can hold a tensor."""
    def sparse(name):
        return onnx.SparseTensorProto(values=external(name + 'v'), indices=external(name + 'i'))

    def graph(name, depth=1):
        attributes = [onnx.AttributeProto(name='t', t=external(name + 't')),
                      onnx.AttributeProto(name='s', tensors=[external(name + 's')]),
                      onnx.AttributeProto(name='p', sparse_tensor=sparse(name + 'p')),
                      onnx.AttributeProto(name='q', sparse_tensors=[sparse(name + 'q')])]
        if depth:
            attributes += [onnx.AttributeProto(name='g', g=graph(name + 'g', depth - 1)),
                           onnx.AttributeProto(name='h', graphs=[graph(name + 'h', depth - 1)])]
        return onnx.GraphProto(node=[onnx.NodeProto(attribute=attributes)],
                               initializer=[external(name + 'n')],
                               sparse_initializer=[sparse(name + 'z')])

    function = onnx.FunctionProto(
        node=[onnx.NodeProto(attribute=[onnx.AttributeProto(t=external('ft'))])],
        attribute_proto=[onnx.AttributeProto(t=external('fa'))])
    training = onnx.TrainingInfoProto(initialization=graph('ti', 0), algorithm=graph('ta', 0))
    return onnx.ModelProto(graph=graph(''), functions=[function], training_info=[training])


def test_every_field_that_may_hold_a_tensor_is_checked(tmp_path):
    model = everywhere()
    (tmp_path / 'n.onnx').write_bytes(model.SerializeToString())
    names = []

    def collect(message):
        for field, value in message.ListFields():
            if field.name == 'external_data':
                names.extend(entry.value for entry in value if entry.key == 'location')
            elif field.message_type:
                for part in ([value] if hasattr(value, 'ListFields') else value):
                    collect(part)

    collect(model)
    assert len(set(names)) == len(names) > 40
    assert read_contents(tmp_path / 'n.onnx').locations == set(names)


@pytest.mark.parametrize('content', [
    b'', b'not a network', b'\x3a\xff\xff\xff\xff\x0f', b'\x3a', b'\x80' * 11, b'\x3b\x3c',
    b'\xba\x80\x80\x80\x10\x00',  # field 7 once the 33rd bit is cut off
    b'\x09\x00'])
def test_files_that_are_not_onnx_are_refused(tmp_path, content):
    (tmp_path / 'n.onnx').write_bytes(content)
    with pytest.raises(ValueError, match=r'n\.onnx is (not a complete ONNX file|empty)'):
        check_file(tmp_path / 'n.onnx')


def test_a_file_cut_anywhere_is_refused_or_names_nothing_new(tmp_path):
    content = write_depth_network(tmp_path / 'whole.onnx').read_bytes()
    for length in range(1, len(content)):
        (tmp_path / 'n.onnx').write_bytes(content[:length])
        try:
            assert read_contents(tmp_path / 'n.onnx').locations == set()
        except ValueError as error:
            assert 'not a complete ONNX file' in str(error)


def test_another_format_than_onnx_is_refused(tmp_path):
    write_depth_network(tmp_path / 'n.onnx').rename(tmp_path / 'n.ort')
    with pytest.raises(ValueError, match='in the format of ONNX Runtime'):
        check_file(tmp_path / 'n.ort')


def call(name, *inputs, output='y'):
    return helper.make_node(name, list(inputs), [output], domain='own')


def function(name, nodes):
    return helper.make_function('own', name, ['x'], ['y'], nodes,
                                [helper.make_opsetid('', 13), helper.make_opsetid('own', 1)])


def doubling(count):
    """Return functions of which each calls the next one twice."""
    last = function(f'f{count}', [helper.make_node('Abs', ['x'], ['y'])])
    return [function(f'f{k}', [call(f'f{k + 1}', 'x', output='t'), call(f'f{k + 1}', 't')])
            for k in range(count)] + [last]


def branches(nested):
    """Return a node with graphs inside each other."""
    if not nested:
        return helper.make_node('Abs', ['image'], ['y'])
    graph = helper.make_graph([branches(nested - 1)], 'branch', [],
                              [helper.make_tensor_value_info('y', FLOAT, None)])
    return helper.make_node('If', ['c'], ['y'], then_branch=graph, else_branch=graph)


def write_calling(path, functions, node):
    """Write a network of one node, and functions; it need not be a valid one."""
    graph = helper.make_graph(
        [node], 'test', [helper.make_tensor_value_info('image', FLOAT, [1, 3, 4, 4])],
        [helper.make_tensor_value_info('y', FLOAT, [1, 3, 4, 4])])
    model = helper.make_model(
        graph, functions=functions, ir_version=8,
        opset_imports=[helper.make_opsetid('', 13), helper.make_opsetid('own', 1)])
    path.write_bytes(model.SerializeToString())
    return path


@pytest.mark.parametrize(('functions', 'node', 'said'), [
    ([function('f0', [call('f0', 'x')])], 'f0', 'one of its functions calls itself'),
    ([function('f0', [call('f1', 'x')]), function('f1', [call('f0', 'x')])], 'f0',
     'one of its functions calls itself'),
    (doubling(20), 'f0', 'its functions expand to more than 1000000 nodes'),
    ([function(f'f{k}', [call(f'f{k + 1}', 'x')]) for k in range(70)], 'f0',
     'more than 64 of its functions call each other'),
    ([], branches(9), 'more than 8 of its graphs are nested'),
    ([function('f0', [branches(5)]), function('f1', [branches(4)])], branches(0), ''),
    (doubling(10), 'f0', ''), ([], branches(8), '')])
def test_functions_and_graphs_without_end_are_refused_before_they_are_loaded(
        tmp_path, functions, node, said):
    node = call(node, 'image') if isinstance(node, str) else node
    path = write_calling(tmp_path / 'n.onnx', functions, node)
    if not said:
        check_file(path)
        return
    with pytest.raises(ValueError, match=f'n.onnx is not loaded: {said}'):
        check_file(path)


def test_graphs_nested_through_a_function_count_together(tmp_path):
    inner = function('f', [branches(5)])
    outer = helper.make_graph([call('f', 'image')], 'branch', [],
                              [helper.make_tensor_value_info('y', FLOAT, None)])
    node = helper.make_node('If', ['c'], ['y'], then_branch=outer, else_branch=outer)
    check_file(write_calling(tmp_path / 'n.onnx', [inner], node))
    for _ in range(3):
        outer = helper.make_graph([node], 'branch', [],
                                  [helper.make_tensor_value_info('y', FLOAT, None)])
        node = helper.make_node('If', ['c'], ['y'], then_branch=outer, else_branch=outer)
    with pytest.raises(ValueError, match='more than 8 of its graphs are nested'):
        check_file(write_calling(tmp_path / 'n.onnx', [inner], node))
