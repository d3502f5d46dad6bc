"""Threads for the numba kernels: each thread works on slices of the items, and no result depends on the number of threads."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

SLICES = 16
"""Number of slices into which any piece of work is cut. It is a constant, so that a sum which is accumulated slice by slice
has the same rounding on every machine."""

threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
"""Number of threads in use. Tests set it to 1 and to 2 and compare the results."""


def for_slices(kernel: Callable[..., None], count: int, *args: object, workers: int | None = None) -> None:
    """Calls `kernel(slice, begin, end, *args)` for each of the SLICES slices of `count` items.

    The kernels release the GIL and write to disjoint places, either by row or by slice.

    Args:
        kernel: called with the slice's number and the first and one-past-last item of the slice.
        count: number of items.
        args: passed on to the kernel.
        workers: number of threads; `threads` by default.
    """
    edges, workers = [count * s // SLICES for s in range(SLICES + 1)], workers or threads
    if workers == 1:
        for s in range(SLICES):
            kernel(s, edges[s], edges[s + 1], *args)
        return
    for done in [_pool(workers, os.getpid()).submit(kernel, s, edges[s], edges[s + 1], *args) for s in range(SLICES)]:
        done.result()


@cache
def _pool(workers: int, process: int) -> ThreadPoolExecutor:
    """The threads of a process, made once: starting them takes longer than a small kernel. A forked process has its own."""
    return ThreadPoolExecutor(workers, thread_name_prefix="slices")
