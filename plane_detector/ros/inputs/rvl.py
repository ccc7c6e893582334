# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Decoding of RVL, the lossless compression of depth images that compressedDepth offers."""

from __future__ import annotations

import numpy as np

_WORD_NIBBLES = 8
_CONTINUES = 8  # bit of a nibble; the other three are of the number
# derived: a difference of two depths has 17 bits with its sign, in groups of three.
_MOST_NIBBLES = 6


def decode_rvl(data: bytes, count: int) -> np.ndarray:
    """
    Return the pixels of an image in the order of its rows.

    Runs of zeros and of other values take turns. Their lengths, and the difference of each value
    to the one before, are numbers of a variable number of nibbles, the least three bits first;
    negative differences are odd. Nibbles fill words of 32 bits, little endian, from the upper end.

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
        The data is not of that many pixels.

    References
    ----------
    Wilson: Fast Lossless Depth Image Compression, ISS 2017.

    Examples
    --------
    >>> decode_rvl(bytes([0, 0, 0xa1, 0x13]), 4)  # nibbles 1, 3, a1, 0, 0: one zero; +5, 0, 0
    array([0, 5, 5, 5], dtype=uint16)

    """
    words = np.frombuffer(data[:len(data) // 4 * 4], '<u4')
    if len(words) * _WORD_NIBBLES > _MOST_NIBBLES * count + 8 * _WORD_NIBBLES:
        raise ValueError(f'the RVL data is longer than {count} pixels can be')
    numbers = _numbers((words[:, None] >> np.arange(28, -1, -4, dtype=np.uint32)).ravel() & 15)
    is_value = np.ones(len(numbers), bool)
    lengths, at, done, coded = [], 0, 0, numbers.tolist()
    while done < count:
        if at + 2 > len(coded):
            raise ValueError('the RVL data breaks off')
        zeros, values = coded[at:at + 2]
        lengths += zeros, values
        is_value[at:at + 2] = False
        at, done = at + 2 + values, done + zeros + values
        if not zeros + values or done > count or at > len(coded):
            raise ValueError(f'the RVL data is not that of {count} pixels')
    changes = numbers[:at][is_value[:at]]
    depths = np.cumsum((changes >> 1) ^ -(changes & 1))
    if len(depths) and not 1 <= depths.min() <= depths.max() <= 65535:
        raise ValueError('the RVL data has a depth that is not in 1 to 65535')
    pixels = np.zeros(count, np.uint16)
    pixels[np.repeat(np.arange(len(lengths)) % 2 == 1, lengths)] = depths
    return pixels


def _numbers(nibbles: np.ndarray) -> np.ndarray:
    """Return the numbers (N,) int64 that end within the nibbles."""
    ends = np.flatnonzero(nibbles < _CONTINUES)
    if not len(ends):
        return ends
    starts = np.concatenate([[0], ends[:-1] + 1])
    if (ends - starts > _WORD_NIBBLES).any():  # three bits of each: no length is so large
        raise ValueError('the RVL data has a number that is too large')
    place = np.arange(ends[-1] + 1) - np.repeat(starts, ends - starts + 1)
    return np.add.reduceat((nibbles[:ends[-1] + 1] & 7).astype(np.int64) << 3 * place, starts)
