# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
One thread for the matrix products of the plane stage.

They are so small that waking a second thread takes longer than the product itself, twice as long
in all where the network or other programs want the other cores.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

P, R = ParamSpec('P'), TypeVar('R')


@cache
def _controller() -> ThreadpoolController:
    """Look for the linear algebra libraries once; numpy's is loaded by now."""
    return ThreadpoolController()


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function to run its linear algebra on one thread."""
    @wraps(function)
    def on_one_thread(*args: P.args, **kwargs: P.kwargs) -> R:
        with _controller().limit(limits=1, user_api='blas'):
            return function(*args, **kwargs)
    return on_one_thread
