# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Stamps of messages as text."""

from __future__ import annotations

from typing import Any


def stamp_text(stamped: Any) -> str:
    """
    Return the stamp of a message, or of what else has a header, in seconds and exact.

    Examples
    --------
    >>> from sensor_msgs.msg import Image
    >>> msg = Image()
    >>> msg.header.stamp.nanosec = 50
    >>> stamp_text(msg)
    '0.000000050'

    """
    stamp = stamped.header.stamp
    return f'{stamp.sec}.{stamp.nanosec:09d}'


def stamp_ns(stamped: Any) -> int:
    """Return the stamp of a message, or of what else has a header, in nanoseconds."""
    return stamped.header.stamp.sec * 1_000_000_000 + stamped.header.stamp.nanosec
