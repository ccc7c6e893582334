# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Malicious networks are refused with a reason, within a limited time."""

from __future__ import annotations

import re
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from common import Row
from onnx_models import PLAIN, onnx_package, write_depth_network, write_network

from plane_detector.config import DepthConfig
from plane_detector.depth.estimator import DepthEstimator

MOST_S = 10.0


def networks(folder: Path) -> list[Row]:
    """Return what loading each hostile network gives."""
    whole = write_depth_network(folder / 'whole.onnx', height=48, width=64).read_bytes()
    rng = np.random.default_rng(0)
    damaged = np.frombuffer(whole, np.uint8).copy()
    damaged[rng.integers(len(damaged), size=20)] ^= 0x55
    files = {'empty': b'', 'random bytes': rng.bytes(10_000),
             'cut in half': whole[:len(whole) // 2], 'damaged in 20 bytes': damaged.tobytes()}
    rows = []
    for name, data in files.items():
        (path := folder / 'hostile.onnx').write_bytes(data)
        rows.append(_refused(f'network file: {name}', path))
    rows.append(_refused('network with weights outside its folder', _with_outside_data(folder)))
    rows.append(_refused('network whose output has size 0', _with_empty_output(folder)))
    return rows


def _refused(name: str, path: Path) -> Row:
    """Return a row for what has to raise ValueError or OSError soon."""
    start_s = time.monotonic()
    try:
        DepthEstimator(replace(DepthConfig(model=str(path), output='metric_depth'), **PLAIN))
        outcome, good = 'taken', False
    except (ValueError, OSError) as error:
        text = re.sub(r'\S*/', '', str(error))[:70]  # no names of temporary folders
        outcome, good = f'{type(error).__name__}: {text}', True
    seconds = time.monotonic() - start_s
    return Row(name, f'refused within {MOST_S:g} s', f'{outcome}, {seconds:.1f} s',
               good and seconds < MOST_S)


def _with_outside_data(folder: Path) -> Path:
    """Write a network whose kernel is in a file of another folder."""
    onnx = onnx_package()
    path = write_depth_network(folder / 'outside.onnx', height=48, width=64)
    model = onnx.load(str(path))
    outside = folder.parent / f'{folder.name}_secret'
    outside.write_bytes(bytes(12))
    kernel = model.graph.initializer[0]
    onnx.external_data_helper.set_external_data(kernel, f'../{outside.name}')
    kernel.ClearField('raw_data')
    path.write_bytes(model.SerializeToString())
    return path


def _with_empty_output(folder: Path) -> Path:
    onnx = onnx_package()
    make, float32 = onnx.helper.make_node, onnx.TensorProto.FLOAT
    ends = [onnx.numpy_helper.from_array(np.array([0], np.int64), 'zero'),
            onnx.numpy_helper.from_array(np.array([1], np.int64), 'axis')]
    return write_network(
        folder / 'none.onnx', [make('Slice', ['image', 'zero', 'zero', 'axis'], ['depth'])],
        [('image', float32, [1, 3, 48, 64])], [('depth', float32, [1, 0, 48, 64])], ends)
