"""The decorators of the model's kernels.

Compiled code is kept in a separate folder for every state of the model's sources, as golden/__init__.py does for the golden
renderer. The reason is that numba notices a change in a kernel's own file only, and not in the modules from which it imports.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numba
from numba.core import config

from golden import kernel_folder
from spec.paths import ROOT

_SOURCES = ("blending", "bus", "chunks", "constants", "dram", "geometry", "layout", "lists", "memory", "plan", "render", "runs",
            "sorter", "warp", "watch")  # the modules of kernels and of the constants that they use


@cache
def _folder() -> Path | None:
    modules = [ROOT / "perf" / f"{name}.py" for name in _SOURCES]
    return kernel_folder("numba-perf", [*modules, *sorted((ROOT / "spec").rglob("*.py"))])


def _compiled(function: Callable, **options: object) -> Callable:
    before, folder = config.CACHE_DIR, _folder()
    config.CACHE_DIR = str(folder) if folder else before
    try:
        return numba.njit(cache=True, error_model="numpy", **options)(function)
    finally:
        config.CACHE_DIR = before


def kernel(function: Callable) -> Callable:
    """`numba.njit` with the model's own cache."""
    return _compiled(function)


def phase(function: Callable) -> Callable:
    """A kernel that creates no array, so that numba does not count references; counting them would take most of its time."""
    return _compiled(function, _nrt=False)


def step(function: Callable) -> Callable:
    """A part of a phase, which numba inlines into it."""
    return numba.njit(inline="always", error_model="numpy")(function)
