"""Compiled kernels that are kept by what they consist of, so that a mutant compiles only the kernels that it changes.

`golden.kernels` keeps compiled code by the sources of everything that a kernel's module imports. This is safe, but a mutant of
a module that all import would compile everything anew, which takes a minute. Here a kernel's key is its byte code, and that of
all functions that it calls, with the values of the constants that they name. What cannot be looked into, such as a function
that writes LLVM's code itself, counts with the whole text of its file. If a change were overlooked, a mutant would seem
unnoticed: the count of what is noticed could only be too low.
"""

from __future__ import annotations

import hashlib
import inspect
import numbers
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba.core import caching
from numba.core.dispatcher import Dispatcher

from golden import kernels
from golden.kernels import KernelCache
from spec.paths import ROOT, cache_folder

_PLAIN = (numbers.Number, np.generic, str, bytes, type(None), type(Ellipsis))


def content(function: FunctionType) -> str:
    """A hash of the byte code of a kernel's plain function, of the values that it names, and of the functions that it calls.
    The options of its own compilation do not count: mutants leave decorators alone."""
    return hashlib.sha256("\n".join(_words(function, frozenset())).encode()).hexdigest()[:20]


def _words(value: object, begun: frozenset[int]) -> Iterator[str]:
    """What determines a value, in words; of functions that call each other, those in `begun` are being described already."""
    if isinstance(value, Dispatcher):
        yield repr(sorted(value.targetoptions.items()))
        value = value.py_func
    if isinstance(value, _PLAIN):
        yield f"{type(value).__name__} {value!r}"
    elif id(value) in begun:
        return
    elif isinstance(value, np.ndarray):
        yield f"{value.dtype} {value.shape} {hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()}"
    elif isinstance(value, tuple | list | frozenset):
        yield f"{type(value).__name__} {len(value)}"
        for item in value:
            yield from _words(item, begun)
    elif isinstance(value, FunctionType) and _file(value) is not None:
        yield from _of_function(value, begun | {id(value)})
    else:
        yield from _of_something(value)


def _of_something(value: object) -> Iterator[str]:
    """A class, a module, or an object that generates code: by name, and by the text of its file if that is the project's."""
    fields = getattr(value, "_fields", None)
    yield f"{getattr(value, '__module__', '')} {getattr(value, '__qualname__', type(value).__qualname__)} {fields!r}"
    path = _file(getattr(value, "_defn", value))  # an intrinsic of numba has the plain function in `_defn`
    if path is not None and fields is None:
        yield path.read_text()


def _of_function(function: FunctionType, begun: frozenset[int]) -> Iterator[str]:
    """The code, and what its names stand for; with the fields of the named tuples of the module, which arguments may be."""
    yield from _of_code(function.__code__)
    yield repr((function.__defaults__, function.__kwdefaults__))
    for cell in function.__closure__ or ():
        yield from _words(cell.cell_contents, begun)
    known = function.__globals__
    for name in sorted(_names(function.__code__)):
        if isinstance(known.get(name), ModuleType):
            yield from _of_module(known[name], sorted(_names(function.__code__)), begun)
        elif name in known:
            yield name
            yield from _words(known[name], begun)
    for name in sorted(known):
        if isinstance(known[name], type) and hasattr(known[name], "_fields"):
            yield f"{name} {known[name]._fields}"


def _of_module(module: ModuleType, names: list[str], begun: frozenset[int]) -> Iterator[str]:
    """A module: if it is the project's, by all of its values that have one of the names."""
    yield module.__name__
    if _file(module) is not None:
        for name in names:
            if hasattr(module, name):
                yield name
                yield from _words(getattr(module, name), begun)


def _of_code(code: CodeType) -> Iterator[str]:
    yield f"{code.co_code.hex()} {code.co_names} {code.co_varnames} {code.co_freevars} {code.co_cellvars}"
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _of_code(constant)
        else:
            yield repr(constant)


def _names(code: CodeType) -> set[str]:
    """The global names and attributes of a function's code and of the functions inside it."""
    return set(code.co_names).union(*(_names(each) for each in code.co_consts if isinstance(each, CodeType)))


def _file(value: Any) -> Path | None:
    """The project's file in which something is defined; None if it is not the project's."""
    with suppress(TypeError, OSError):
        path = Path(inspect.getfile(value)).resolve()
        if path.is_relative_to(ROOT) and "site-packages" not in path.parts:
            return path
    return None


class _Locator(caching._CacheLocator):
    """Where the code of a function is kept: one folder for all, with the contents in the file's name."""

    def __init__(self, function: FunctionType, state: str) -> None:
        self._state, self._folder = state, cache_folder("kernels-by-content", function.__module__)

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        return ""

    def get_disambiguator(self) -> str:
        return self._state

    def ensure_cache_path(self) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)


class ContentCache:
    """The cache of one kernel. It is made when code is asked for: until then what the kernel calls may not be defined."""

    def __init__(self, function: FunctionType) -> None:
        self._function, self._made = function, None

    def _cache(self) -> Any:
        if self._made is None:
            locator = _Locator(self._function, content(self._function))
            implementation = type("_Implementation", (caching.CompileResultCacheImpl,), {
                "_locator_classes": [type("_Found", (), {"from_function": staticmethod(lambda *_: locator)})]})
            self._made = type("_Cache", (KernelCache,), {"_impl_class": implementation})(self._function)
        return self._made

    def load_overload(self, sig: object, target_context: object) -> object:
        """The kept code for argument types, or None."""
        return self._cache().load_overload(sig, target_context)

    def save_overload(self, sig: object, data: object) -> None:
        """Keeps code."""
        self._cache().save_overload(sig, data)


def keep_by_content() -> None:
    """From now on, kernels that this process defines are kept by their contents."""
    kernels.KernelCache = ContentCache
