"""Threads of the CPU renderer's kernels: as many as torch uses, so that one setting is for both."""

from __future__ import annotations

from collections.abc import Callable

import torch

from golden.threads import for_slices


def run_slices(kernel: Callable[..., None], count: int, *args: object) -> None:
    """`for_slices` on `torch.get_num_threads()` threads; no result depends on how many."""
    for_slices(kernel, count, *args, workers=torch.get_num_threads())
