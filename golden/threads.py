"""Threads for the numba kernels: each call gets a slice of the work, and no result depends on how many threads there are."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

SLICES = 16
"""Slices of any piece of work: a constant, so that even code that works slice by slice gives the same result everywhere."""

threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
"""Threads in use; tests set it to 1 and 2 and compare."""


def for_slices(kernel: Callable[..., None], count: int, *args: object, workers: int | None = None) -> None:
    """Calls `kernel(slice, begin, end, *args)` for every slice of `count` items, on `workers` threads (default: `threads`).

    Kernels release the GIL and write to disjoint places, by row or by slice.
    """
    edges = [count * s // SLICES for s in range(SLICES + 1)]
    with ThreadPoolExecutor(workers or threads) as pool:
        for done in [pool.submit(kernel, s, edges[s], edges[s + 1], *args) for s in range(SLICES)]:
            done.result()
