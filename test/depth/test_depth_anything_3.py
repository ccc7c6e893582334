# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Depth Anything 3, by networks of the same form: five dimensions, two files, bytes."""

import dataclasses
import hashlib

import needs_onnxruntime  # noqa: F401
import numpy as np
import pytest
from onnx_geometry_models import (
    encoded,
    put_in_cache,
    write_bytes_network,
    write_scene_network,
)

from plane_detector.config import DepthConfig
from plane_detector.depth.estimator import DepthEstimator
from plane_detector.depth.networks import IMAGENET_MEAN, IMAGENET_STD, NETWORKS, cached_path

SCENE, BYTES = 'depth_anything_3_small', 'depth_anything_3_small_518'
WIDTH, HEIGHT = 56, 42
DEPTH_M = np.round(np.tile(np.linspace(1, 3, WIDTH), (HEIGHT, 1)), 3)


@pytest.fixture(name='folder')
def fixture_folder(monkeypatch, tmp_path):
    """A cache with the two files of the network."""
    path = cached_path(NETWORKS[SCENE], tmp_path)
    path.parent.mkdir()
    write_scene_network(path, IMAGENET_MEAN, IMAGENET_STD)
    data = path.with_name('model.onnx_data')
    weights = dataclasses.replace(NETWORKS[SCENE].weights[0], size_bytes=data.stat().st_size,
                                  sha256=hashlib.sha256(data.read_bytes()).hexdigest())
    network = dataclasses.replace(NETWORKS[SCENE], weights=(weights,),
                                  size_bytes=path.stat().st_size,
                                  sha256=hashlib.sha256(path.read_bytes()).hexdigest())
    monkeypatch.setitem(NETWORKS, SCENE, network)
    return path.parent


def estimator(cache_dir, name=SCENE):
    side = HEIGHT if name == SCENE else 0
    return DepthEstimator(DepthConfig(model=name, cache_dir=str(cache_dir), short_side=side))


def test_a_network_of_scenes_in_two_files_gives_depth_up_to_scale(folder, tmp_path):
    found = estimator(tmp_path).predict(encoded(DEPTH_M, 0))
    assert found.output == 'relative_depth'
    np.testing.assert_allclose(found.values, 4 * DEPTH_M, rtol=1e-3)


def test_a_network_that_takes_bytes_gives_the_same(monkeypatch, tmp_path):
    put_in_cache(monkeypatch, BYTES, write_bytes_network(tmp_path / 'n.onnx', WIDTH, HEIGHT))
    found = estimator(tmp_path, BYTES).predict(encoded(DEPTH_M, 0))
    assert found.output == 'relative_depth'
    np.testing.assert_allclose(found.values, 4 * DEPTH_M, rtol=1e-3)


@pytest.mark.parametrize('name', ['model.onnx', 'model.onnx_data'])
def test_each_file_is_verified_before_it_is_loaded(folder, tmp_path, name, monkeypatch):
    content = bytearray((folder / name).read_bytes())
    content[-1] ^= 1
    (folder / name).write_bytes(content)
    monkeypatch.setattr('plane_detector.depth.networks.download', no_network)
    with pytest.raises(FileNotFoundError, match='the cached file is damaged'):
        estimator(tmp_path)


def no_network(*_):
    raise OSError('no network')


def test_by_hand_both_files_are_named(monkeypatch, tmp_path):
    monkeypatch.setattr('plane_detector.depth.networks.download', no_network)
    with pytest.raises(FileNotFoundError) as caught:
        estimator(tmp_path)
    for file in (f'{SCENE}/model.onnx (640691 bytes', 'model.onnx_data (104702464 bytes'):
        assert file in str(caught.value)
