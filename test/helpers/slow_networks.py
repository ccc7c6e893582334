# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Networks that take for ever, in every call or on bright images only.

ONNX Runtime looks at its flag to terminate between two operators. The endless loop has such
places, the pooling over huge windows has none: that one is deaf.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from onnx_models import constant, onnx_package, write_network

HEIGHT, WIDTH = 48, 64
# 2e13 comparisons in one operator, which takes hours, and 72 MB.
_DEAF_SIDE, _DEAF_WINDOW = 3000, 1501


def write_slow_network(path: Path, *, deaf: bool = False, always: bool = False) -> Path:
    """
    Write a network for images of 64 x 48 whose depth is the red channel, if it ever comes.

    Deaf, one operator takes hours, instead of many short ones for ever; always, also on a black
    image, with which a network is warmed up.
    """
    make, float32 = onnx_package().helper.make_node, onnx_package().TensorProto.FLOAT
    same = _graph('same', [make('Identity', ['red'], ['quick'])], [], [('quick', float32, None)])
    slow, slow_constants = _deaf_operator() if deaf else _endless_loop()
    branch = _graph('slow', slow, [], [('slow', float32, None)])
    nodes = [make('Slice', ['image', 'zero', 'first', 'axis'], ['red']),
             make('ReduceMax', ['image'], ['brightest'], keepdims=0),
             make('Greater', ['brightest', 'limit'], ['is_bright']),
             make('If', ['is_bright'], ['depth'], then_branch=branch, else_branch=same)]
    constants = [constant('zero', [0], np.int64), constant('first', [1], np.int64),
                 constant('axis', [1], np.int64),
                 constant('limit', -1.0 if always else 0.5), *slow_constants]
    return write_network(path, nodes, [('image', float32, [1, 3, HEIGHT, WIDTH])],
                         [('depth', float32, [1, 1, HEIGHT, WIDTH])], constants)


def _deaf_operator() -> tuple[list, list]:
    """Return nodes from red to slow, one of which takes hours, and their constants."""
    make = onnx_package().helper.make_node
    return [make('ReduceMax', ['red'], ['redmost'], keepdims=1),
            make('Expand', ['redmost', 'wide_shape'], ['wide']),
            make('MaxPool', ['wide'], ['pooled'], kernel_shape=[_DEAF_WINDOW] * 2,
                 pads=[_DEAF_WINDOW // 2] * 4),
            make('ReduceMax', ['pooled'], ['top'], keepdims=1),
            make('Add', ['red', 'top'], ['slow'])], [
        constant('wide_shape', [1, 1, _DEAF_SIDE, _DEAF_SIDE], np.int64)]


def _endless_loop() -> tuple[list, list]:
    """Return nodes from red to slow, a loop of short operators, and their constants."""
    make, proto = onnx_package().helper.make_node, onnx_package().TensorProto
    step = _graph('step', [make('Identity', ['going'], ['goes_on']),
                           make('Add', ['sum', 'one'], ['next'])],
                  [('index', proto.INT64, []), ('going', proto.BOOL, []),
                   ('sum', proto.FLOAT, None)],
                  [('goes_on', proto.BOOL, []), ('next', proto.FLOAT, None)])
    return [make('Loop', ['for_ever', 'true', 'red'], ['slow'], body=step)], [
        constant('for_ever', 2**62, np.int64), constant('true', True, np.bool_),
        constant('one', 1.0)]


def _graph(name: str, nodes: list, inputs: list, outputs: list) -> object:
    helper = onnx_package().helper
    infos = ([helper.make_tensor_value_info(*end) for end in ends] for ends in (inputs, outputs))
    return helper.make_graph(nodes, name, *infos)
