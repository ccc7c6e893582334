# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Measured depth in every form, and what is refused."""

import struct

import numpy as np
import pytest
from compressed_bombs import png_bomb
from depth_messages import QUANTISATION_A, cloud_msg, compressed_depth_msg, encode_rvl
from ros_helpers import image_msg

from plane_detector.geometry.projection import depth_to_points
from plane_detector.ros.inputs.depth_decoding import check_rays, depth_from_msg, depth_size
from plane_detector.ros.inputs.rvl import decode_rvl
from plane_detector.types import CameraIntrinsics

CAMERA = CameraIntrinsics(60.0, 62.0, 39.5, 29.5, 80, 60)
MOST_PIXELS = 10_000


def decoded(msg, unit_m=0.0):
    return depth_from_msg(msg, MOST_PIXELS, unit_m)


def sloped_m():
    """Return a slope from 1 to 3 m with a hole and an edge."""
    depth_m = np.linspace(1, 3, 60 * 80, dtype=np.float32).reshape(60, 80)
    depth_m[10:20, 30:50] = np.nan
    depth_m[30:, :20] = 6.0
    return depth_m


@pytest.mark.parametrize('encoding', ['32FC1', 'R_FLOAT32'])
@pytest.mark.parametrize('big_endian', [False, True])
def test_depth_in_metres(encoding, big_endian):
    depth_m = np.array([[1.5, np.nan, np.inf], [0.0, -1.0, 70.0]], np.float32)
    found = decoded(image_msg(depth_m, encoding, padding=4, big_endian=big_endian))
    np.testing.assert_array_equal(found, [[1.5, np.nan, np.nan], [np.nan, np.nan, 70.0]])
    assert found.dtype == np.float32
    assert found.dtype.isnative


@pytest.mark.parametrize('big_endian', [False, True])
@pytest.mark.parametrize('encoding', ['16UC1', 'mono16'])
def test_depth_in_millimetres(encoding, big_endian):
    depth_mm = np.array([[1500, 0], [65535, 1]], np.uint16)
    found = decoded(image_msg(depth_mm, encoding, padding=2, big_endian=big_endian))
    np.testing.assert_allclose(found, [[1.5, np.nan], [65.535, 0.001]], rtol=1e-6)


@pytest.mark.parametrize('unit_m', [0.0001, 0.00025, 0.0002])
def test_other_units(unit_m):
    counts = np.array([[10000, 0], [4000, 40]], np.uint16)
    expected = [[10000 * unit_m, np.nan], [4000 * unit_m, 40 * unit_m]]
    np.testing.assert_allclose(decoded(image_msg(counts, '16UC1'), unit_m), expected, rtol=1e-6)
    metres = image_msg(counts.astype(np.float32), '32FC1')
    np.testing.assert_allclose(decoded(metres, unit_m), expected, rtol=1e-6)
    cloud = cloud_msg(np.repeat(counts[..., None], 3, axis=2))
    np.testing.assert_allclose(decoded(cloud, unit_m), expected, rtol=1e-6)


def test_depth_of_another_encoding_is_refused():
    with pytest.raises(ValueError, match='8UC1'):
        decoded(image_msg(np.zeros((2, 2), np.uint8), '8UC1'))


@pytest.mark.parametrize('kind', ['png', 'rvl'])
@pytest.mark.parametrize('encoding, error_m', [('16UC1', 5e-4), ('32FC1', 2e-3)])
def test_compressed_depth(encoding, error_m, kind):
    msg = compressed_depth_msg(sloped_m(), encoding, kind)
    found = decoded(msg)
    assert depth_size(msg) == (80, 60)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(sloped_m()))
    np.testing.assert_allclose(found, sloped_m(), atol=error_m)
    assert found.dtype == np.float32


def test_compressed_depth_in_another_unit():
    found = decoded(compressed_depth_msg(sloped_m(), unit_m=0.00025), 0.00025)
    np.testing.assert_allclose(found, sloped_m(), atol=1.3e-4)


@pytest.mark.parametrize('seed', range(4))
def test_rvl_gives_back_what_was_encoded(seed):
    """Of few and many values, near to each other and far, with and without zeros at the ends."""
    rng = np.random.default_rng(seed)
    for count in (1, 2, 7, 8, 9, 1000):
        pixels = rng.integers(0, rng.choice([2, 300, 65536]), count).astype(np.uint16)
        pixels[rng.random(count) < rng.choice([0.0, 0.5, 1.0])] = 0
        np.testing.assert_array_equal(decode_rvl(encode_rvl(pixels), count), pixels)


def rvl_data():
    yield 'empty', b'', 'truncated'
    yield 'cut', encode_rvl(np.arange(1, 1001, dtype=np.uint16))[:100], 'truncated'
    yield 'more pixels', encode_rvl(np.ones(1001, np.uint16)), 'does not have 1000'
    yield 'no pixels', bytes(400), 'does not have 1000'
    yield 'no values in a million runs', bytes.fromhex('10101010') * 250_000, 'does not have 1000'
    yield 'huge run', b'\xff' * 11 + b'\x7f', 'too large'
    yield 'endless number', b'\xff' * 100, 'too large'
    yield 'no depth', bytes.fromhex('00000013'), 'outside 1 to 65535'


@pytest.mark.parametrize('data, reason', [
    pytest.param(data, reason, id=name) for name, data, reason in rvl_data()])
def test_rvl_that_is_not_of_the_image_is_refused(data, reason):
    with pytest.raises(ValueError, match=reason):
        decode_rvl(data, 1000)


def test_rvl_of_depths_that_no_image_has_is_refused():
    down = bytes.fromhex('00001001')  # nibbles 0, 1, 1: one value, a change of -1
    with pytest.raises(ValueError, match='outside 1 to 65535'):
        decode_rvl(down, 1)


def with_data(kind='png', change=lambda data: data, form=None):
    msg = compressed_depth_msg(sloped_m(), kind=kind)
    msg.data = change(bytes(msg.data))
    msg.format = msg.format if form is None else form
    return msg


BAD = {
    'short': (with_data(change=lambda data: data[:15]), 'only 15 bytes'),
    'no header': (with_data(change=lambda data: data[12:]), 'after 12 bytes, it is neither'),
    'png bomb': (with_data(change=lambda data: data[:12] + png_bomb(30000, 30000)),
                 'is 30000 x 30000'),
    'colour png': (with_data(change=lambda data: data[:12] + png_bomb(60, 60)), 'cannot be decoded'
                   '|does not have 16 bits'),
    'rvl bomb': (with_data('rvl', lambda data: data[:12] + struct.pack('<II', 2**31, 2**31)),
                 'is 2147483648 x 2147483648'),
    'rvl without pixels': (with_data('rvl', lambda data: data[:12] + bytes(8)), 'is 0 x 0'),
    'format': (with_data(form='rgb8; jpeg'), "'rgb8' is not supported"),
    'png as rvl': (with_data(form='16UC1; compressedDepth rvl'), 'compressedDepth image is')}


@pytest.mark.parametrize('msg, reason', BAD.values(), ids=BAD)
def test_compressed_depth_that_is_damaged_is_refused(msg, reason):
    with pytest.raises(ValueError, match=reason):
        decoded(msg)


def test_a_hostile_quantisation_gives_no_depth_but_no_error():
    for parameters in ((np.nan, 0.0), (np.inf, -np.inf), (QUANTISATION_A, np.nan), (0.0, 0.0)):
        msg = compressed_depth_msg(sloped_m(), '32FC1')
        msg.data = struct.pack('<iff', 0, *parameters) + bytes(msg.data)[12:]
        assert np.isnan(decoded(msg)).all()


@pytest.mark.parametrize('dtype', ['<f4', '>f4', '<f8'])
def test_an_organised_cloud(dtype):
    msg = cloud_msg(depth_to_points(sloped_m(), CAMERA), dtype=dtype)
    check_rays(msg, CAMERA)
    np.testing.assert_allclose(decoded(msg), sloped_m(), rtol=1e-6)


def test_a_cloud_in_another_frame_is_refused():
    points_m = depth_to_points(sloped_m(), CAMERA)
    with pytest.raises(ValueError, match='must be in the optical frame'):
        check_rays(cloud_msg(points_m[..., [2, 0, 1]] * [1, -1, -1]), CAMERA)
    check_rays(cloud_msg(np.full((60, 80, 3), np.nan)), CAMERA)


def bad_clouds():
    good = depth_to_points(sloped_m(), CAMERA)
    yield 'unorganised', cloud_msg(good.reshape(1, -1, 3)), 'not organised'
    short = cloud_msg(good)
    short.data = short.data[:-1]
    yield 'short', short, '76799|bytes, but it is 80 x 60'
    steps = cloud_msg(good)
    steps.row_step = 3
    yield 'row step', steps, 'but it is 80 x 60'
    beyond = cloud_msg(good)
    beyond.fields[2].offset = 2**32 - 1
    yield 'beyond', beyond, 'field z of the point cloud is beyond'
    nameless = cloud_msg(good)
    nameless.fields[2].name = 'intensity'
    yield 'no z', nameless, 'no field z of type'
    whole = cloud_msg(good)
    whole.fields[2].datatype = 6
    yield 'integers', whole, 'no field z of type'


@pytest.mark.parametrize('msg, reason', [pytest.param(m, r, id=i) for i, m, r in bad_clouds()])
def test_clouds_that_cannot_be_depth_are_refused(msg, reason):
    with pytest.raises(ValueError, match=reason):
        decoded(msg)
