# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Decoding of RVL, the lossless compression of depth images that compressedDepth offers."""

from __future__ import annotations

import numpy as np

from plane_detector._runtime.compilation import kernel

_WORD_NIBBLES = 8
_CONTINUES = 8  # bit of a nibble; the other three are of the number
# derived: no number in an image has more than 31 bits, in groups of three.
_MOST_SHIFT = 30
_ENDS, _TOO_LARGE, _MISFIT, _RANGE = 1, 2, 3, 4


def decode_rvl(data: bytes, count: int) -> np.ndarray:
    """
    Return the pixels of an image in the order of its rows.

    Runs of zeros and of other values alternate. Their lengths, and the difference of each value
    from the previous one, are numbers with a variable number of nibbles, the lowest three bits
    first; negative differences are odd. Nibbles fill little-endian words of 32 bits from the upper
    end.

    Parameters
    ----------
    data : bytes
        Without the size of the image.
    count : int
        Number of pixels.

    Returns
    -------
    (count,) uint16

    Raises
    ------
    ValueError
        The data does not have that number of pixels.

    References
    ----------
    Wilson: Fast Lossless Depth Image Compression, ISS 2017.

    Examples
    --------
    >>> decode_rvl(bytes([0, 0, 0xa1, 0x13]), 4)  # nibbles 1, 3, a1, 0, 0: one zero; +5, 0, 0
    array([0, 5, 5, 5], dtype=uint16)

    """
    words = np.frombuffer(data[:len(data) // 4 * 4], '<u4')
    pixels = np.zeros(count, np.uint16)
    fault = _decode(words, pixels)
    if fault == _ENDS:
        raise ValueError('the RVL data is truncated')
    if fault == _TOO_LARGE:
        raise ValueError('the RVL data contains a number that is too large')
    if fault == _MISFIT:
        raise ValueError(f'the RVL data does not have {count} pixels')
    if fault == _RANGE:
        raise ValueError('the RVL data contains a depth outside 1 to 65535')
    return pixels


@kernel("UniTuple(int64, 2)(Array(uint32, 1, 'C', readonly=True), int64)", subject='rvl')
def _number(words, at):
    """Return the number that starts at a nibble, or minus an error code, and the next nibble."""
    number, shift, nibble = 0, 0, _CONTINUES
    while nibble >= _CONTINUES:
        if at == len(words) * _WORD_NIBBLES:
            return -_ENDS, at
        if shift > _MOST_SHIFT:
            return -_TOO_LARGE, at
        place = 28 - 4 * (at % _WORD_NIBBLES)
        nibble = (np.int64(words[at // _WORD_NIBBLES]) >> place) & 15
        number |= (nibble & 7) << shift
        at, shift = at + 1, shift + 3
    return number, at


@kernel("int64(Array(uint32, 1, 'C', readonly=True), uint16[::1])", subject='rvl')
def _decode(words, pixels):
    """Fill the pixels; return an error code, or 0."""
    at, done, depth = 0, 0, 0
    while done < len(pixels):
        zeros, at = _number(words, at)
        values, at = _number(words, at)
        if min(zeros, values) < 0:
            return -min(zeros, values)
        done += zeros
        # An encoder writes no run without values, but for the zeros at the end: each round fills
        # pixels, so that hostile data takes no longer than an image.
        if done + values > len(pixels) or (values == 0 and done < len(pixels)):
            return _MISFIT
        for k in range(done, done + values):
            change, at = _number(words, at)
            if change < 0:
                return -change
            depth += (change >> 1) ^ -(change & 1)
            if depth < 1 or depth > 65535:
                return _RANGE
            pixels[k] = depth
        done += values
    return 0
