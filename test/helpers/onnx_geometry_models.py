# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
ONNX networks with the inputs and outputs of MoGe-2 and Metric3D v2 that decode truth from colours.

Red and green hold the depth in millimetres as in `onnx_models`, blue the angle of a normal
(sin a, 0, -cos a) with a = (blue / 255 - 0.5) * 2 radians.
"""

from __future__ import annotations

import dataclasses
import hashlib
from pathlib import Path

import numpy as np
from onnx_models import (
    METRES_OF_RGB,
    constant,
    millimetres_as_rgb,
    onnx_package,
    write_network,
)

from plane_detector.depth.networks import NETWORKS

SCALE_PER_TOKEN = 1 / 480
"""The scale of the point map is the number of tokens times this."""


def angle_deg_of(blue: np.ndarray) -> np.ndarray:
    return np.degrees((blue / 255 - 0.5) * 2)


def encoded(depth_m: np.ndarray, blue: np.ndarray | int) -> np.ndarray:
    """Return the image (H, W, 3) uint8 of a depth and of normals."""
    rgb = millimetres_as_rgb(depth_m)
    rgb[..., 2] = blue
    return rgb


def put_in_cache(monkeypatch, name: str, path: Path) -> None:
    """Let a file in its own folder be the verified file of a network of the zoo."""
    network = dataclasses.replace(NETWORKS[name], file_name=path.name,
                                  sha256=hashlib.sha256(path.read_bytes()).hexdigest())
    monkeypatch.setitem(NETWORKS, name, network)


def write_point_map_network(path: Path, rays: np.ndarray, *, shift: float = 0.7,
                            facing: int = 1, element_of_mask: str = 'FLOAT') -> Path:
    """
    Write a network with the interface of MoGe-2, whose pixels have these rays (h, w, 2).

    The shift in metres is taken from the z of all points; normals look at the camera (1) or away
    (-1); the mask, FLOAT or BOOL, is 0 where red and green are.
    """
    proto, make = onnx_package().TensorProto, onnx_package().helper.make_node
    height, width = rays.shape[:2]
    directions = np.concatenate([rays, np.ones((height, width, 1))], axis=-1)[None]
    nodes = [
        *_channels(), *_points(), *_normals(),
        make('Transpose', ['normal_first'], ['normal'], perm=[0, 2, 3, 1]),
        make('Greater', ['z', 'nothing'], ['is_there']),
        make('Squeeze', ['is_there', 'channel_axis'], ['is_there_3d']),
        make('Cast', ['is_there_3d'], ['mask'], to=getattr(proto, element_of_mask))]
    shape = [1, height, width]
    return write_network(
        path, nodes, [('image', proto.FLOAT, [1, 3, height, width]),
                      ('num_tokens', proto.INT64, [])],
        [('points', proto.FLOAT, [*shape, 3]), ('normal', proto.FLOAT, [*shape, 3]),
         ('mask', getattr(proto, element_of_mask), shape), ('scale', proto.FLOAT, [])],
        [*_constants(255.0, facing), constant('rays', directions),
         constant('shift', [0, 0, shift]), constant('scale_per_token', SCALE_PER_TOKEN),
         constant('nothing', 1e-6)])


def write_canonical_network(path: Path) -> Path:
    """Write a network with the interface of Metric3D v2; its confidence is blue / 255."""
    proto, make = onnx_package().TensorProto, onnx_package().helper.make_node
    nodes = [
        *_channels('pixel_values'),
        make('Mul', ['rg', 'metres'], ['rg_m']),
        make('ReduceSum', ['rg_m', 'channel_axis'], ['predicted_depth'], keepdims=1),
        *_normals(), make('Identity', ['normal_first'], ['predicted_normal']),
        make('Squeeze', ['blue', 'channel_axis'], ['blue_3d']),
        make('Mul', ['blue_3d', 'to_unit'], ['normal_confidence'])]
    free = ['height', 'width']
    return write_network(
        path, nodes, [('pixel_values', proto.FLOAT, [1, 3, *free])],
        [('predicted_depth', proto.FLOAT, [1, 1, *free]),
         ('predicted_normal', proto.FLOAT, [1, 3, *free]),
         ('normal_confidence', proto.FLOAT, [1, *free])], _constants(1.0, 1))


def _channels(image: str = 'image') -> list:
    make = onnx_package().helper.make_node
    return [make('Slice', [image, 'zero', 'two', 'channel_axis'], ['rg']),
            make('Slice', [image, 'two', 'three', 'channel_axis'], ['blue'])]


def _points() -> list:
    """Return what makes scaled, shifted points [1, h, w, 3] of red and green."""
    make = onnx_package().helper.make_node
    return [make('Mul', ['rg', 'metres'], ['rg_m']),
            make('ReduceSum', ['rg_m', 'channel_axis'], ['z'], keepdims=1),
            make('Transpose', ['z'], ['z_last'], perm=[0, 2, 3, 1]),
            make('Mul', ['z_last', 'rays'], ['points_m']),
            make('Sub', ['points_m', 'shift'], ['shifted_m']),
            make('Cast', ['num_tokens'], ['tokens'], to=onnx_package().TensorProto.FLOAT),
            make('Mul', ['tokens', 'scale_per_token'], ['scale']),
            make('Div', ['shifted_m', 'scale'], ['points'])]


def _normals() -> list:
    """Return what makes normals [1, 3, h, w] of blue."""
    make = onnx_package().helper.make_node
    return [make('Mul', ['blue', 'to_two'], ['twice']), make('Sub', ['twice', 'one'], ['angle']),
            make('Sin', ['angle'], ['sine']), make('Cos', ['angle'], ['cosine']),
            make('Sub', ['sine', 'sine'], ['none']), make('Neg', ['cosine'], ['minus_cosine']),
            make('Concat', ['sine', 'none', 'minus_cosine'], ['looking'], axis=1),
            make('Mul', ['looking', 'facing'], ['normal_first'])]


def _constants(full: float, facing: int) -> list:
    """Return the constants of a network whose image is 0 to 255 / ``full``."""
    metres = np.reshape([256, 1], (1, 2, 1, 1)) * full / 1000
    floats = {'metres': metres, 'to_two': 2 * full / 255, 'to_unit': full / 255, 'one': 1.0,
              'facing': facing}
    integers = {'zero': 0, 'two': 2, 'three': 3, 'channel_axis': 1}
    return [*(constant(name, value) for name, value in floats.items()),
            *(constant(name, [value], np.int64) for name, value in integers.items())]


def write_scene_network(path: Path, mean: tuple[float, ...], std: tuple[float, ...]) -> Path:
    """
    Write a network with the interface of Depth Anything 3: any images of a scene, two files.

    Its depth is in 4 times the unit of the metre; the weights are in ``model.onnx_data``.
    """
    onnx, make = onnx_package(), onnx_package().helper.make_node
    weights = 4 * np.array(METRES_OF_RGB)
    nodes = [make('Mul', ['pixel_values', 'kernel'], ['weighted']),
             make('ReduceSum', ['weighted', 'channel_axis'], ['mixed'], keepdims=0),
             make('Add', ['mixed', 'bias'], ['predicted_depth']),
             make('Sub', ['mixed', 'mixed'], ['confidence'])]
    scene = ['batch', 'images', 'height', 'width']
    write_network(path, nodes,
                  [('pixel_values', onnx.TensorProto.FLOAT, [*scene[:2], 3, *scene[2:]])],
                  [(name, onnx.TensorProto.FLOAT, scene)
                   for name in ('predicted_depth', 'confidence')],
                  [constant('kernel', np.reshape(weights * std, (1, 1, 3, 1, 1))),
                   constant('bias', weights @ mean), constant('channel_axis', [2], np.int64)])
    # By the size of the Python object, which is 33 bytes more: the kernel, but not the axis.
    onnx.save(onnx.load(str(path)), str(path), save_as_external_data=True, size_threshold=44,
              location=path.name + '_data')
    return path


def write_bytes_network(path: Path, width: int, height: int) -> Path:
    """Write a network that takes bytes and gives depth in 4 times the unit of the metre."""
    proto, make = onnx_package().TensorProto, onnx_package().helper.make_node
    nodes = [make('Cast', ['image'], ['colours'], to=proto.FLOAT),
             make('MatMul', ['colours', 'kernel'], ['mixed']),
             make('Squeeze', ['mixed', 'last_axis'], ['depth'])]
    return write_network(
        path, nodes, [('image', proto.UINT8, [1, height, width, 3])],
        [('depth', proto.FLOAT, [1, height, width])],
        [constant('kernel', np.reshape(4 * np.array(METRES_OF_RGB) / 255, (3, 1))),
         constant('last_axis', [3], np.int64)])
