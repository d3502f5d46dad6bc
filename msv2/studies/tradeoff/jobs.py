"""Distributes independent pieces of work over processes of this machine, or over a Dask cluster."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import cache
from importlib.util import find_spec
from typing import Any

import numba

from spec.errors import InputError
from spec.extras import how_to_get


def run_all(
    work: Callable[..., Any], calls: Sequence[tuple[object, ...]], *, jobs: int = 1, scheduler: str | None = None,
) -> Iterator[tuple[int, Any]]:
    """Yields (index, result) of `work(*call)` for every call, in the order in which they finish.

    Args:
        work: a function that can be imported wherever it runs. On a cluster, the workers need this project and the same paths.
        calls: the arguments of the calls.
        jobs: the number of processes; with 1 the work is done in this process.
        scheduler: the address of a Dask scheduler, such as tcp://HOST:PORT; `jobs` then has no effect.

    Raises:
        InputError: Dask is not installed, the scheduler does not answer, or `jobs` is below 1.
    """
    if jobs < 1:
        raise InputError(f"jobs {jobs} is not accepted: 1 or more is")
    if scheduler is not None:
        yield from _on_cluster(work, calls, scheduler)
    elif jobs == 1 or len(calls) < 2:
        for index, call in enumerate(calls):
            yield index, work(*call)
    else:
        pending = {_pool(jobs).submit(work, *call): index for index, call in enumerate(calls)}
        try:
            for done in as_completed(pending):
                yield pending[done], done.result()
        except BaseException:
            _pool(jobs).shutdown(wait=False, cancel_futures=True)
            _pool.cache_clear()
            raise


@cache
def _pool(jobs: int) -> ProcessPoolExecutor:
    """A pool of processes that is kept, so that what a process has loaded and compiled serves later calls."""
    return ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn"), initializer=_with_one_thread)


def _with_one_thread() -> None:
    """Limits a process to one thread, since the threads of several processes would wait for each other."""
    numba.set_num_threads(1)


def _on_cluster(work: Callable[..., Any], calls: Sequence[tuple[object, ...]], scheduler: str) -> Iterator[tuple[int, Any]]:
    if find_spec("distributed") is None:
        raise InputError(f"scheduler {scheduler!r} is not accepted: Dask is not installed; {how_to_get('distributed')}; "
                         "or leave the scheduler out to work on this machine")
    import distributed

    try:
        client = distributed.Client(scheduler, timeout=10)
    except (OSError, ValueError) as error:
        raise InputError(f"scheduler {scheduler!r} is not accepted ({error}): the address of one that runs is") from error
    with client:
        pending = {client.submit(work, *call, pure=False): index for index, call in enumerate(calls)}
        for done in distributed.as_completed(list(pending)):
            yield pending[done], done.result()
