# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Small ONNX networks whose depth is a known function of the pixels.

`millimetres_as_rgb` writes a depth image into the red and green of another, and the network
of `write_depth_network` reads it back, so that a test knows the depth that a network gives.
Tests that write a network are skipped where onnx is missing, as it is after rosdep.
"""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

PLAIN = {'mean': (0.0, 0.0, 0.0), 'std': (1.0, 1.0, 1.0)}
"""Settings of `DepthConfig` under which the networks here read metres."""
# Of R, G, B in 0 to 1: depth_m = (256 R + G) * 255 / 1000.
METRES_OF_RGB = (65.28, 0.255, 0.0)


def network_parameters(path: Path) -> dict[str, object]:
    """Return the node's parameters for such a network; colours that code depth have no lines."""
    return {'depth.model': str(path), 'depth.output': 'metric_depth', 'depth.mean': [0.0] * 3,
            'depth.std': [1.0] * 3, 'directions.orient_planes': False}


def network_arguments(path: Path) -> list[str]:
    """Return the same as arguments of a program."""
    return [word for name, value in network_parameters(path).items()
            for word in ('-p', f'{name}:={value}')]


def millimetres_as_rgb(depth_m: np.ndarray) -> np.ndarray:
    """Return an image (H, W, 3) uint8 with the depth in whole millimetres; NaN becomes 0."""
    millimetres = np.rint(np.nan_to_num(depth_m) * 1000).astype(np.uint16)
    rgb = np.zeros((*depth_m.shape, 3), np.uint8)
    rgb[..., 0], rgb[..., 1] = millimetres >> 8, millimetres & 255
    return rgb


def write_depth_network(path: Path, *, height: int | str = 'height', width: int | str = 'width',
                        channels_last: bool = False, dtype: type = np.float32,
                        weights: tuple[float, ...] = (*METRES_OF_RGB, 0.0)) -> Path:
    """
    Write a network that gives weights . (R, G, B, 1) of the normalised colours at every pixel.

    Free sides have a name instead of a number; channels_last is [1, H, W, 3] -> [1, H, W, 1]. The
    type, float32 or float16, is that of input and output.
    """
    onnx = onnx_package()
    helper, float32 = onnx.helper, onnx.TensorProto.FLOAT

    def shape(channels: int) -> list[int | str]:
        return [1, height, width, channels] if channels_last else [1, channels, height, width]

    kernel = np.reshape(np.float32(weights[:3]), (3, 1) if channels_last else (1, 3, 1, 1))
    end = {np.float32: float32, np.float16: onnx.TensorProto.FLOAT16}[dtype]
    nodes = [
        helper.make_node('Cast', ['image'], ['image32'], to=float32),
        helper.make_node('MatMul' if channels_last else 'Conv', ['image32', 'kernel'], ['mixed']),
        helper.make_node('Add', ['mixed', 'bias'], ['depth32']),
        helper.make_node('Cast', ['depth32'], ['depth'], to=end)]
    constants = [constant('kernel', kernel), constant('bias', sum(weights[3:]))]
    return write_network(path, nodes, [('image', end, shape(3))], [('depth', end, shape(1))],
                         constants)


def write_network(path: Path, nodes: list, inputs: list[tuple], outputs: list[tuple],
                  constants: list = ()) -> Path:
    """Write a network of these nodes; inputs and outputs are (name, element type, shape)."""
    onnx, helper = onnx_package(), onnx_package().helper
    graph = helper.make_graph(
        nodes, 'test', [helper.make_tensor_value_info(*end) for end in inputs],
        [helper.make_tensor_value_info(*end) for end in outputs], list(constants))
    # The oldest versions that do, so that every supported ONNX Runtime loads it.
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid('', 13)], ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, str(path))
    return path


def constant(name: str, value: object, dtype: type = np.float32) -> object:
    """Return a named constant of a network."""
    return onnx_package().numpy_helper.from_array(np.asarray(value, dtype), name)


def onnx_package() -> ModuleType:
    """Return the package onnx; the test is skipped where it or what runs it is missing."""
    pytest.importorskip('onnxruntime', reason='ONNX Runtime, for networks, is not installed')
    return pytest.importorskip('onnx', reason='onnx, of the extra "test", is not installed')
