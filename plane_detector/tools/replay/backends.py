# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Backends for many bags: processes on this machine, or a cluster, through joblib.

Dask and Ray are only needed on clusters that use them
(``pip install plane_detector[dask]`` or ``[ray]``).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import joblib
from joblib.externals.loky import get_reusable_executor


@contextmanager
def use_backend(name: str, jobs: int, scheduler: str = '') -> Iterator[int | str]:
    """
    Make `joblib.Parallel` use a backend; yield its ``pre_dispatch``, the jobs in flight.

    Parameters
    ----------
    name : str
        ``processes``, ``dask`` or ``ray``.
    jobs : int
        Jobs at a time; on Dask the cluster decides.
    scheduler : str
        Address of the cluster; for Ray empty: one is started here for this run.

    Raises
    ------
    ModuleNotFoundError
        The backend is not installed.
    ValueError
        Dask needs the address of a scheduler.
    OSError
        The cluster does not answer.

    """
    with {'processes': _processes, 'dask': _dask, 'ray': _ray}[name](jobs, scheduler) as ahead:
        yield ahead


def kill_processes() -> None:
    """End the processes of the pool on this machine at once."""
    get_reusable_executor().shutdown(wait=False, kill_workers=True)


@contextmanager
def _processes(jobs: int, _scheduler: str) -> Iterator[int]:
    jobs = joblib.effective_n_jobs(jobs)
    # With one worker joblib would use this process, which a crash in a library would end.
    with joblib.parallel_config('loky', n_jobs=max(jobs, 2), inner_max_num_threads=1):
        yield jobs


@contextmanager
def _dask(jobs: int, scheduler: str) -> Iterator[str]:
    if not scheduler:
        raise ValueError('--backend dask needs the address of a scheduler: --scheduler '
                         'tcp://HOST:8786')
    try:
        from dask.distributed import Client
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f'{error}: --backend dask needs pip install "dask[distributed]", here and on the '
            'workers', name=error.name) from error
    with Client(scheduler, set_as_default=False) as client, joblib.parallel_config(
            'dask', n_jobs=jobs, client=client):
        yield 'all'


@contextmanager
def _ray(jobs: int, scheduler: str) -> Iterator[str]:
    try:
        import ray
        from ray.util.joblib import register_ray
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f'{error}: --backend ray needs pip install ray, here and on '
                                  'the workers', name=error.name) from error
    cpus = {} if scheduler or jobs < 1 else {'num_cpus': jobs}
    # Its pool warns of an argument that joblib gives.
    ray.init(address=scheduler or 'local', log_to_driver=False, logging_level='ERROR', **cpus)
    register_ray()
    try:
        with joblib.parallel_config('ray', n_jobs=jobs):
            yield 'all'
    finally:
        ray.shutdown()
