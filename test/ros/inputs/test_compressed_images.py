# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Compressed images: only JPEG and PNG of the right size are decoded."""

import cv2
import numpy as np
import pytest
from compressed_bombs import PNG_BEGIN, jpeg_bomb, jpeg_of_many_scans, png_bomb, png_chunk
from ros_helpers import header
from sensor_msgs.msg import CompressedImage

from plane_detector.ros.inputs import image_decoding
from plane_detector.ros.inputs.image_decoding import (
    MOST_SCANS,
    compressed_size,
    rgb_from_compressed_msg,
)

COLOUR = np.array([200, 100, 30], np.uint8)
SIZE = (18, 16)
MOST_PIXELS = 1000


def encoded(extension, size=SIZE, flags=()):
    image = np.broadcast_to(COLOUR, (size[1], size[0], 3))
    return cv2.imencode(extension, image[..., ::-1], list(flags))[1].tobytes()


def decoded(data, expected=SIZE, most_pixels=MOST_PIXELS):
    msg = CompressedImage(header=header(), format='jpeg', data=data)
    return rgb_from_compressed_msg(msg, expected, most_pixels)


@pytest.mark.parametrize('data', [
    encoded('.png', (640, 480)), encoded('.jpg', (640, 480)),
    encoded('.jpg', (640, 480), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]),
    encoded('.jpg', (640, 480), [cv2.IMWRITE_JPEG_RST_INTERVAL, 1])])
def test_the_header_tells_the_size(data):
    assert compressed_size(data) == (640, 480)


def bombs():
    yield 'png', png_bomb(30000, 30000), 'is 30000 x 30000'
    yield 'jpeg', jpeg_bomb(30000, 30000), 'is 30000 x 30000'
    yield 'png chunk', encoded('.png')[:33] + b'\x7f' + encoded('.png')[34:], 'breaks off'
    yield 'png end', encoded('.png')[:-12] + b'\x7f' + encoded('.png')[-11:], 'breaks off'
    yield 'scans', jpeg_of_many_scans(*SIZE, MOST_SCANS + 1), f'more than {MOST_SCANS}'


def others():
    yield 'empty', b'', 'neither a JPEG nor a PNG'
    yield 'text', b'not an image', 'neither a JPEG nor a PNG'
    for extension in ('.webp', '.bmp', '.tiff', '.pgm'):
        yield extension, cv2.imencode(extension, np.zeros((16, 18), np.uint8))[1].tobytes(), \
            'neither a JPEG nor a PNG'
    yield 'cut png', encoded('.png')[:20], 'breaks off'
    yield 'png without its end', encoded('.png')[:-12], 'breaks off'
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
