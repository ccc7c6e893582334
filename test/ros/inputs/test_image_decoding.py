# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Every encoding, padding and byte order of the images, compressed ones, and what is refused."""

import struct

import cv2
import numpy as np
import pytest
from compressed_bombs import PNG_BEGIN, jpeg_bomb, jpeg_of_many_scans, png_bomb, png_chunk
from ros_helpers import header, image_msg
from sensor_msgs.msg import CompressedImage, Image

from plane_detector.ros.inputs import image_decoding
from plane_detector.ros.inputs.image_decoding import (
    MOST_SCANS,
    compressed_size,
    rgb_from_compressed_msg,
    rgb_from_msg,
)

COLOUR = np.array([200, 100, 30], np.uint8)
BAYER = {'bayer_rggb8': [[0, 1], [1, 2]], 'bayer_bggr8': [[2, 1], [1, 0]],
         'bayer_gbrg8': [[1, 2], [0, 1]], 'bayer_grbg8': [[1, 0], [2, 1]]}


@pytest.fixture
def rgb():
    return np.random.default_rng(0).integers(0, 256, (6, 8, 3), np.uint8)


@pytest.mark.parametrize('padding', [0, 5])
@pytest.mark.parametrize('encoding, order', [
    ('rgb8', [0, 1, 2]), ('bgr8', [2, 1, 0]), ('rgba8', [0, 1, 2, 0]), ('bgra8', [2, 1, 0, 0])])
def test_colour_channels_come_in_order(rgb, encoding, order, padding):
    msg = image_msg(rgb[..., order], encoding, padding=padding)
    np.testing.assert_array_equal(rgb_from_msg(msg), rgb)


@pytest.mark.parametrize('big_endian', [False, True])
def test_mono16_keeps_the_high_byte(big_endian):
    grey = np.array([[0x1234, 0xFF00], [0x00FF, 0x8001]], np.uint16)
    decoded = rgb_from_msg(image_msg(grey, 'mono16', padding=2, big_endian=big_endian))
    np.testing.assert_array_equal(decoded[..., 1], [[0x12, 0xFF], [0x00, 0x80]])


def test_8uc1_is_grey():
    grey = np.array([[1, 2], [200, 255]], np.uint8)
    np.testing.assert_array_equal(rgb_from_msg(image_msg(grey, '8UC1'))[..., 2], grey)


@pytest.mark.parametrize('encoding, luma', [('yuv422', 1), ('uyvy', 1), ('yuv422_yuy2', 0),
                                            ('yuyv', 0)])
def test_yuv_422(encoding, luma):
    y, u, v = 120, 90, 200
    pixels = np.zeros((2, 4, 2), np.uint8)
    pixels[..., luma] = y
    pixels[:, 0::2, 1 - luma], pixels[:, 1::2, 1 - luma] = u, v
    decoded = rgb_from_msg(image_msg(pixels, encoding, padding=4)).astype(int)
    red = 1.164 * (y - 16) + 1.596 * (v - 128)
    blue = 1.164 * (y - 16) + 2.018 * (u - 128)
    assert abs(decoded[..., 0] - red).max() <= 1
    assert abs(decoded[..., 2] - blue).max() <= 1


@pytest.mark.parametrize('encoding', BAYER)
def test_bayer_of_one_colour(encoding):
    mosaic = np.tile(COLOUR[np.array(BAYER[encoding])], (3, 4))
    decoded = rgb_from_msg(image_msg(mosaic, encoding, padding=1))
    np.testing.assert_array_equal(decoded, np.broadcast_to(COLOUR, (6, 8, 3)))


def half_colour_msg(encoding, shape=(4, 6), padding=0):
    """Return an image of one colour: y 120, u 90, v 200."""
    rows = np.full((shape[0] * 3 // 2, shape[1]), 120, np.uint8)
    first, second = (90, 200) if encoding == 'nv12' else (200, 90)
    rows[shape[0]:, 0::2], rows[shape[0]:, 1::2] = first, second
    msg = image_msg(rows, encoding, padding=padding)
    msg.height = shape[0]
    return msg


@pytest.mark.parametrize('padding', [0, 3])
@pytest.mark.parametrize('encoding', ['nv12', 'nv21'])
def test_colour_at_half_the_resolution(encoding, padding):
    decoded = rgb_from_msg(half_colour_msg(encoding, padding=padding)).astype(int)
    assert decoded.shape == (4, 6, 3)
    assert abs(decoded[..., 0] - (1.164 * (120 - 16) + 1.596 * (200 - 128))).max() <= 1
    assert abs(decoded[..., 2] - (1.164 * (120 - 16) + 2.018 * (90 - 128))).max() <= 1


def bad_images():
    good = np.zeros((4, 6, 3), np.uint8)
    yield 'unknown', image_msg(good, 'rgb32'), 'rgb32'
    yield 'empty', Image(encoding='rgb8'), 'empty'
    short_step = image_msg(good, 'rgb8')
    short_step.step = 17
    yield 'step', short_step, 'step is 17'
    short_data = image_msg(good, 'rgb8')
    short_data.data = short_data.data[:-1]
    yield 'data', short_data, '71 bytes'
    long_data = image_msg(good, 'rgb8')
    long_data.data.append(0)
    yield 'long data', long_data, '73 bytes'
    yield 'odd yuv', image_msg(np.zeros((2, 3, 2), np.uint8), 'yuv422'), 'even'
    yield 'tiny bayer', image_msg(np.zeros((2, 2), np.uint8), 'bayer_rggb8'), 'too small'


@pytest.mark.parametrize('msg, reason', [pytest.param(m, r, id=i) for i, m, r in bad_images()])
def test_bad_images_are_refused_with_the_reason(msg, reason):
    with pytest.raises(ValueError, match=reason):
        rgb_from_msg(msg)


SIZE = (18, 16)
MOST_PIXELS = 1000


def encoded(extension, size=SIZE, flags=()):
    image = np.broadcast_to(COLOUR, (size[1], size[0], 3))
    return cv2.imencode(extension, image[..., ::-1], list(flags))[1].tobytes()


def decoded(data, expected=SIZE, most_pixels=MOST_PIXELS):
    msg = CompressedImage(header=header(), format='jpeg', data=data)
    return rgb_from_compressed_msg(msg, expected, most_pixels)


def test_the_orientation_in_a_jpeg_file_is_ignored():
    """CameraInfo and depth are of the pixels as they are."""
    rgb = np.zeros((16, 32, 3), np.uint8)
    rgb[:, :16] = 255
    data = cv2.imencode('.jpg', rgb)[1].tobytes()
    upside_down = b'MM\0*' + struct.pack('>IHHHIHHI', 8, 1, 0x0112, 3, 1, 3, 0, 0)
    exif = b'Exif\0\0' + upside_down
    data = data[:2] + b'\xff\xe1' + struct.pack('>H', len(exif) + 2) + exif + data[2:]
    assert cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[0, 0, 0] < 10
    assert decoded(data, (32, 16))[0, 0, 0] > 245


@pytest.mark.parametrize('data', [
    encoded('.png', (640, 480)), encoded('.jpg', (640, 480)),
    encoded('.jpg', (640, 480), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]),
    encoded('.jpg', (640, 480), [cv2.IMWRITE_JPEG_RST_INTERVAL, 1])])
def test_the_header_gives_the_size(data):
    assert compressed_size(data) == (640, 480)


def bombs():
    yield 'png', png_bomb(30000, 30000), 'is 30000 x 30000'
    yield 'jpeg', jpeg_bomb(30000, 30000), 'is 30000 x 30000'
    yield 'png chunk', encoded('.png')[:33] + b'\x7f' + encoded('.png')[34:], 'truncated'
    yield 'png end', encoded('.png')[:-12] + b'\x7f' + encoded('.png')[-11:], 'truncated'
    yield 'scans', jpeg_of_many_scans(*SIZE, MOST_SCANS + 1), f'more than {MOST_SCANS}'


def others():
    yield 'empty', b'', 'neither a JPEG nor a PNG'
    yield 'text', b'not an image', 'neither a JPEG nor a PNG'
    for extension in ('.webp', '.bmp', '.tiff', '.pgm'):
        yield extension, cv2.imencode(extension, np.zeros((16, 18), np.uint8))[1].tobytes(), \
            'neither a JPEG nor a PNG'
    yield 'cut png', encoded('.png')[:20], 'truncated'
    yield 'png without its end', encoded('.png')[:-12], 'truncated'
    yield 'cut jpeg', encoded('.jpg')[:30], 'no size'
    yield 'png without a size', (PNG_BEGIN + png_chunk(b'IHDR', bytes(13))
                                 + png_chunk(b'IEND', b'')), 'no size'
    yield 'jpeg without a height', jpeg_bomb(18, 0), 'no size'


@pytest.mark.parametrize('expected', [SIZE, (0, 0)], ids=['of a known size', 'of any size'])
@pytest.mark.parametrize('data, reason', [
    pytest.param(data, reason, id=name) for name, data, reason in (*bombs(), *others())])
def test_images_are_refused_before_they_are_decoded(data, reason, expected, monkeypatch):
    def decode(*_):
        pytest.fail('decoded')

    monkeypatch.setattr(image_decoding.cv2, 'imdecode', decode)
    with pytest.raises(ValueError, match=reason):
        decoded(data, expected)
