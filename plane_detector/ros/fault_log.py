# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Faults in the log: in one line, cut and escaped, each kind at limited intervals.

The text of a fault may quote data from outside: of any length, with line breaks and escape
sequences, and different in every frame.
"""

from __future__ import annotations

import time
import traceback
from typing import Any

from plane_detector._runtime.plain_text import plain

MOST_OF_FAILURE = 1000
"""Limit for a fault that ends a transition; it may explain how to copy a network by hand."""
WARN_PERIOD_S = 5.0
"""Each kind of fault is logged at most once within this time."""


def reason_of(error: Exception) -> str:
    """Return why data cannot be used; an error other than ValueError is a bug, with its name."""
    return plain(str(error) if isinstance(error, ValueError)
                 else f'{type(error).__name__}: {error}')


class FaultLog:
    """
    Logs why data from outside cannot be used; ``what`` is the start of each line.

    The kind of a fault is its type and the line of code that raised it, not its text.
    """

    def __init__(self, logger: Any, what: str):
        self._logger, self._what = logger, what
        self._logged_s: dict[tuple[type, str, int], float] = {}

    def report(self, error: Exception, where: str = '') -> str:
        """Log the reason and where it arose, at limited intervals; return the reason alone."""
        reason = reason_of(error)
        # Another exception than ValueError is a bug, or a part that is missing.
        self._log(error, reason + (where and f' ({where})'), not isinstance(error, ValueError))
        return reason

    def report_bug(self, error: Exception) -> None:
        """Log an exception that no code expects, with its traceback, at limited intervals."""
        self._log(error, plain(f'{type(error).__name__}: {error}'), with_traceback=True)

    def _log(self, error: Exception, text: str, with_traceback: bool) -> None:
        raised_at = traceback.extract_tb(error.__traceback__)
        last = raised_at[-1] if raised_at else traceback.FrameSummary('', 0, '')
        if self._is_due((type(error), last.filename, last.lineno)):
            self._logger.warning(f'{self._what}: {text}')
            if with_traceback:
                self._logger.warning('raised at\n' + ''.join(traceback.format_list(raised_at)))

    def _is_due(self, kind: tuple[type, str, int]) -> bool:
        now_s = time.monotonic()
        if now_s - self._logged_s.get(kind, -WARN_PERIOD_S) < WARN_PERIOD_S:
            return False
        self._logged_s[kind] = now_s
        return True
