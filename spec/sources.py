"""Finds the files of the project on which a module depends: its own file, and those of all modules that it imports,
transitively.

Caches and reports are keyed by the contents of these files. So a changed constant in `spec` invalidates everything that depends
on it, and a change in any other file invalidates nothing.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

from spec.paths import ROOT

ROOMS = ("spec", "golden", "rtl", "perf", "synth", "tb", "msv2")
"""The folders that hold the project's modules."""

_FROM = re.compile(r"^[ \t]*from[ \t]+([\w.]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n]+)", re.MULTILINE)
_IMPORT = re.compile(r"^[ \t]*import[ \t]+([\w., \t]+)", re.MULTILINE)


def imported_names(text: str) -> set[str]:
    """The dotted names that a source text imports anywhere: modules, and `module.name` for each name imported from a module.

    Import statements are found by a pattern, without parsing. A line of a docstring that looks like one adds a superfluous
    name.
    """
    names = set()
    for module, taken in _FROM.findall(text):
        parts = re.sub(r"#[^\n]*", "", taken).strip("() \n").split(",")
        names |= {module} | {f"{module}.{words[0]}" for part in parts if (words := part.split())}
    for modules in _IMPORT.findall(text):
        names |= {words[0] for part in modules.split(",") if (words := part.split())}
    return names


def module_file(name: str, root: Path = ROOT) -> Path | None:
    """The file of a module or package of the project; None where there is none."""
    base = root.joinpath(*name.split("."))
    return next((path for path in (base.with_suffix(".py"), base / "__init__.py") if path.is_file()), None)


@lru_cache(maxsize=256)
def sources_of(*modules: str, closed: frozenset[str] = frozenset(), root: Path = ROOT) -> tuple[Path, ...]:
    """The files of the modules and of all the project's modules that they import, transitively; sorted.

    Args:
        modules: dotted names, such as "golden.msv2_ref.pipeline".
        closed: dotted names of modules whose own imports do not count.
        root: the folder that holds ROOMS.

    Raises:
        ValueError: there is no such module.
    """
    found: set[Path] = set()
    todo = list(modules)
    while todo:
        name = todo.pop()
        path = module_file(name, root)
        if path is None and name in modules:
            raise ValueError(f"there is no module {name!r} of this project")
        if path is None or path in found or (name.partition(".")[0] not in ROOMS and name not in modules):
            continue
        found.add(path)
        packages = name.split(".")[:-1]
        todo += [".".join(packages[: depth + 1]) for depth in range(len(packages))]
        names = () if name in closed else imported_names(path.read_text(encoding="utf-8"))
        todo += [other for other in names if other.partition(".")[0] in ROOMS]
    return tuple(sorted(found))


def fingerprint(files: Iterable[Path], *parts: object) -> str:
    """A hash of 16 hexadecimal digits of the contents of the files and of the `repr` of the parts."""
    state = hashlib.sha256()
    for path in files:
        state.update(path.read_bytes())
    for part in parts:
        state.update(repr(part).encode())
    return state.hexdigest()[:16]
