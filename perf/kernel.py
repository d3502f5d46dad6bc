"""The decorator of the model's kernels.

Their compiled code is kept in a folder of its own for every state of the model's sources, as golden/__init__.py does for the
golden renderer's: numba notices an edit in a kernel's own file only, not in what it takes from others.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numba
from numba.core import config

import golden

_ROOT = Path(golden.__file__).resolve().parent.parent
_KEPT = 4  # states whose compiled kernels are kept
_SOURCES = ("blending", "bus", "constants", "dram", "geometry", "layout", "lists", "memory", "plan", "render", "runs", "sorter",
            "warp", "watch")  # modules of kernels, and of their constants


@cache
def _folder() -> Path | None:
    state = hashlib.sha256()
    for source in (*(_ROOT / "perf" / f"{name}.py" for name in _SOURCES), *sorted((_ROOT / "spec").rglob("*.py"))):
        state.update(source.read_bytes())
    folder = _ROOT / "build" / "numba-perf" / state.hexdigest()[:16]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        for old in sorted(folder.parent.iterdir(), key=lambda path: path.stat().st_mtime)[:-_KEPT]:
            shutil.rmtree(old, ignore_errors=True)
    except OSError:  # a read-only checkout: numba's own choice of a folder is better than none
        return None
    return folder


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
    """A kernel that makes no array, so that none needs its references counted: that would take most of its time."""
    return _compiled(function, _nrt=False)


def step(function: Callable) -> Callable:
    """A part of a phase, compiled into it."""
    return numba.njit(inline="always", error_model="numpy")(function)
