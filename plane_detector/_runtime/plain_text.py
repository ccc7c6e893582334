# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Text from outside, such as a server's answer or a frame_id, for the log or a terminal."""

from __future__ import annotations

MOST_CHARACTERS = 400


def plain(text: str, most: int = MOST_CHARACTERS) -> str:
    r"""
    Return a text as one line of printable characters, truncated if it is long.

    Examples
    --------
    >>> plain('a\nb')
    'a\\nb'
    >>> plain(100 * 'a', 3)
    'aaa... (100 characters)'

    """
    seen = ''.join(character if character.isprintable()
                   else character.encode('unicode_escape').decode()
                   for character in text[:most])
    return seen if len(text) <= most else f'{seen}... ({len(text)} characters)'
