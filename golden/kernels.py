"""The decorator of all numba kernels: it keeps their compiled code, and measures the time of compilation separately.

numba's own cache notices an edit in a kernel's own file only. It does not notice an edit in functions and constants that the
kernel takes from other files, and would go on running stale code. Here compiled code is stored by the contents of the kernel's
module and of everything of ours that the module imports (`spec.sources`), in the user's cache folder. Several processes may use
it at the same time.
"""

from __future__ import annotations

import os
import shutil
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path

import llvmlite
import numba
from numba.core import caching, config, event
from numba.core.dispatcher import Dispatcher

from spec.paths import ROOT, cache_folder
from spec.private import locked
from spec.progress import LiveLine, as_time, keep_seconds, last_seconds, on_terminal, pool_on_terminal
from spec.sources import fingerprint, sources_of

STATES_KEPT = 8
"""Number of states of a module's sources whose compiled kernels are kept in any case."""

KEPT_SECONDS = 24 * 3600
"""Seconds for which other states are kept after their last use, because another checkout may be working with them."""

_TOOLS = frozenset({"golden.kernels"})  # what this module imports finds folders and hashes: no compiled code depends on it


def compiled(function: Callable | None = None, **options: object) -> Callable:
    """`numba.njit` with the project's cache: `@compiled` or `@compiled(nogil=True)`, with the options of `numba.njit`."""
    def decorate(plain: Callable) -> Callable:
        kernel = numba.njit(**options)(plain)
        if isinstance(kernel, Dispatcher):  # NUMBA_DISABLE_JIT leaves plain functions
            kernel._cache = KernelCache(plain)
        return kernel

    return decorate if function is None else decorate(function)


@cache
def kernel_folder(module: str, root: Path = ROOT) -> Path:
    """The folder in which the compiled kernels of a module are kept for the present state of its sources."""
    sources = sources_of(module, closed=_TOOLS, root=root)
    state = fingerprint(sources, numba.__version__, llvmlite.__version__, config.BOUNDSCHECK)
    folder = cache_folder("kernels", module, state)
    with suppress(OSError):
        os.utime(folder)
    return folder


def _module_of(source: Path) -> str:
    """Dotted name of a file of the project, also if it is the running program, which Python names `__main__`."""
    return ".".join(source.resolve().relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def _forget_old_states(folder: Path) -> None:
    """Deletes old states in a folder, except those used last."""
    states = sorted((path for path in folder.iterdir() if path.is_dir()), key=lambda path: path.stat().st_mtime)
    for old in states[:-STATES_KEPT]:
        if time.time() - old.stat().st_mtime > KEPT_SECONDS:
            shutil.rmtree(old, ignore_errors=True)


class _Locator(caching._CacheLocator):
    """Tells numba where a function's code is kept. The folder's name stands for the sources' state, so files need no stamp."""

    def __init__(self, py_func: Callable, py_file: str) -> None:
        self._py_file, self._line = py_file, py_func.__code__.co_firstlineno
        self._folder = kernel_folder(_module_of(Path(py_file)))

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        return ""

    def get_disambiguator(self) -> str:
        return str(self._line)

    def ensure_cache_path(self) -> None:
        if not self._folder.is_dir():
            self._folder.mkdir(parents=True, exist_ok=True)
            _forget_old_states(self._folder.parent)

    @classmethod
    def from_function(cls, py_func: Callable, py_file: str) -> _Locator:
        return cls(py_func, py_file)


class _Implementation(caching.CompileResultCacheImpl):
    _locator_classes = [_Locator]


class LockedFile(caching.IndexDataCacheFile):
    """The files of one kernel, to which only one process at a time adds.

    numba names a kernel's files by numbers that are free in its index. Two processes that compile the kernel for different
    types at the same time would take the same number, and later one's code would run on the other's data.
    """

    def save(self, key: tuple, data: object) -> None:
        with locked(Path(self._cache_path) / "lock"):
            super().save(key, data)


class KernelCache(caching.Cache):
    """The compiled code of one kernel, in the folder that its implementation's locator names."""

    _impl_class = _Implementation

    def __init__(self, py_func: Callable) -> None:
        super().__init__(py_func)
        self._cache_file = LockedFile(
            self._cache_path, self._impl.filename_base, self._impl.locator.get_source_stamp())

    # If the disk is full or the folder cannot be read or written, this costs time but changes no result.

    def load_overload(self, sig: object, target_context: object) -> object:
        with suppress(OSError):
            return super().load_overload(sig, target_context)
        return None

    def save_overload(self, sig: object, data: object) -> None:
        with suppress(OSError):
            super().save_overload(sig, data)


class _CompileTime(event.Listener):
    """Adds up the time of compilations and shows on a terminal which kernel is being compiled. The time of a kernel includes
    that of the functions that it calls."""

    def __init__(self) -> None:
        self.seconds, self.kernels = 0.0, 0
        self._depth, self._begin = 0, 0.0  # one thread at a time: compilation holds numba's lock

    def on_start(self, what: event.Event) -> None:
        if self._depth == 0:
            if self.kernels == 0 and not on_terminal():
                print(f"compiling kernels: {_WHY}", file=sys.stderr, flush=True)
            self._name = _kernel_name(what)
            before = last_seconds(self._name)
            if before is not None and before > _WORTH_A_LINE and pool_on_terminal():
                print(f"compiling {self._name} ({as_time(before)} last time)", file=sys.stderr, flush=True)
            self._line = LiveLine(self._text(before))
            self._line.__enter__()
            self._begin = time.perf_counter()
        self._depth += 1

    def on_end(self, _: event.Event) -> None:
        self._depth -= 1
        if self._depth == 0:
            spent = time.perf_counter() - self._begin
            self.seconds, self.kernels = self.seconds + spent, self.kernels + 1
            self._line.__exit__(None, None, None)
            if spent > _WORTH_KEEPING:
                keep_seconds(self._name, spent)

    def _text(self, before: float | None) -> Callable[[float], str]:
        hint = "" if before is None else f" ({as_time(before)} last time)"
        done = f"; {self.kernels} compiled before in {as_time(self.seconds)}" if self.kernels else f"; {_WHY}"
        return lambda seconds: f"compiling {self._name}: {as_time(seconds)}{hint}{done}"


_WHY = "the first run after a change of their sources takes longer"

_WORTH_KEEPING = 0.5
"""Seconds of a kernel's compilation from which on its time is kept for the next one."""


_WORTH_A_LINE = 5
"""Seconds that a kernel took last time from which on a pool's worker names it; it has no live line."""


def _kernel_name(compilation: event.Event) -> str:
    """`kernel` and the module and name of the function that an event of numba's compiles."""
    function = getattr((compilation.data or {}).get("dispatcher"), "py_func", None)
    return "kernel" if function is None else f"kernel {function.__module__}.{function.__name__}"


_compile_time = _CompileTime()
event.register("numba:compile", _compile_time)


def compile_seconds() -> float:
    """Seconds that this process has spent compiling kernels. Only the first run after a change of the sources compiles."""
    return _compile_time.seconds


def compiled_kernels() -> int:
    """The number of kernels that this process has compiled; functions that a kernel calls count with it."""
    return _compile_time.kernels


def compile_note() -> str:
    """The part of a command's last line that tells the time of compilation; empty if nothing was compiled."""
    seconds = compile_seconds()
    return f"; kernels were compiled in {seconds:.1f} s, which is not counted" if seconds else ""


def work_clock() -> float:
    """Seconds of a clock that stops while kernels are compiled; only differences have a meaning."""
    return time.perf_counter() - _compile_time.seconds
