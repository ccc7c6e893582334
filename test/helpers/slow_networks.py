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
from onnx_models import onnx_package, write_network

HEIGHT, WIDTH = 48, 64
# 2e13 comparisons in one operator, which takes hours, and 72 MB.
_DEAF_SIDE, _DEAF_WINDOW = 3000, 1501


def write_slow_network(path: Path, *, deaf: bool = False, always: bool = False) -> Path:
    """
    Write a network for images of 64 x 48 whose depth is the red channel, if it ever comes.

    Parameters
    ----------
    path : Path
    deaf : bool
        One operator takes hours, instead of many short ones for ever.
    always : bool
        Also on a black image, with which a network is warmed up.

    """
    onnx = onnx_package()
    helper, make = onnx.helper, onnx.helper.make_node
    float32, of_bool, int64 = (onnx.TensorProto.FLOAT, onnx.TensorProto.BOOL,
                               onnx.TensorProto.INT64)

    def constant(name: str, value: object, dtype: type) -> object:
        return onnx.numpy_helper.from_array(np.array(value, dtype), name)

    def graph(name: str, nodes: list, inputs: list, outputs: list) -> object:
        def infos(ends: list) -> list:
            return [helper.make_tensor_value_info(*end) for end in ends]
        return helper.make_graph(nodes, name, infos(inputs), infos(outputs))

    same = graph('same', [make('Identity', ['red'], ['quick'])], [], [('quick', float32, None)])
    if deaf:
        slow = [make('ReduceMax', ['red'], ['redmost'], keepdims=1),
                make('Expand', ['redmost', 'wide_shape'], ['wide']),
                make('MaxPool', ['wide'], ['pooled'], kernel_shape=[_DEAF_WINDOW] * 2,
                     pads=[_DEAF_WINDOW // 2] * 4),
                make('ReduceMax', ['pooled'], ['top'], keepdims=1),
                make('Add', ['red', 'top'], ['slow'])]
        slow_constants = [constant('wide_shape', [1, 1, _DEAF_SIDE, _DEAF_SIDE], np.int64)]
    else:
        step = graph('step', [make('Identity', ['going'], ['goes_on']),
                              make('Add', ['sum', 'one'], ['next'])],
                     [('index', int64, []), ('going', of_bool, []), ('sum', float32, None)],
                     [('goes_on', of_bool, []), ('next', float32, None)])
        slow = [make('Loop', ['for_ever', 'true', 'red'], ['slow'], body=step)]
        slow_constants = [constant('for_ever', 2**62, np.int64), constant('true', True, np.bool_),
                          constant('one', 1.0, np.float32)]
    branch = graph('slow', slow, [], [('slow', float32, None)])
    nodes = [make('Slice', ['image', 'zero', 'first', 'axis'], ['red']),
             make('ReduceMax', ['image'], ['brightest'], keepdims=0),
             make('Greater', ['brightest', 'limit'], ['is_bright']),
             make('If', ['is_bright'], ['depth'], then_branch=branch, else_branch=same)]
    constants = [constant('zero', [0], np.int64), constant('first', [1], np.int64),
                 constant('axis', [1], np.int64),
                 constant('limit', -1.0 if always else 0.5, np.float32), *slow_constants]
    return write_network(path, nodes, [('image', float32, [1, 3, HEIGHT, WIDTH])],
                         [('depth', float32, [1, 1, HEIGHT, WIDTH])], constants)
