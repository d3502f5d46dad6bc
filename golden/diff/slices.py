"""Threads of the CPU renderer's kernels: as many as torch uses, so that one setting controls both."""

from __future__ import annotations

from collections.abc import Callable

import torch

from golden.threads import for_slices


def run_slices(kernel: Callable[..., None], count: int, *args: object) -> None:
    """Calls `for_slices` on `torch.get_num_threads()` threads; no result depends on their number."""
    for_slices(kernel, count, *args, workers=torch.get_num_threads())
