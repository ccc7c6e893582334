# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The plane stage has one thread for its linear algebra, its caller has what it had."""

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from plane_detector.threads import one_blas_thread


def threads():
    """Return the threads that each linear algebra library would use."""
    return [library['num_threads'] for library in threadpool_info()
            if library['user_api'] == 'blas']


@one_blas_thread
def threads_within(*, fail=False):
    if fail:
        raise ValueError
    return threads()


@pytest.mark.parametrize('count', [1, 2])
def test_one_thread_within_as_many_as_before_behind(count):
    with threadpool_limits(count, 'blas'):
        before = threads()
        assert set(threads_within()) == {1}
        assert threads() == before


def test_an_error_leaves_as_many_threads_as_before():
    with threadpool_limits(2, 'blas'):
        before = threads()
        with pytest.raises(ValueError):
            threads_within(fail=True)
        assert threads() == before
