"""A cache of emitted Verilog. Emission takes seconds, and every run needs the emitted text to decide whether a simulator must
be rebuilt."""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable
from functools import cache, partial
from importlib.metadata import version

from rtl import units
from rtl.emit import sources_are_kept
from spec.config import AcceleratorConfig
from spec.paths import ROOT, cache_folder
from spec.progress import phase

FOLDER = cache_folder("emitted")


def emitted(name: str, config: AcceleratorConfig, emit: Callable[[AcceleratorConfig], str] | None = None) -> str:
    """The Verilog of a unit. It comes from the cache if rtl/, spec/, Amaranth and the configuration have not changed.

    `emit(config)` emits it, or, without `emit`, `rtl.units` emits the unit of this name. While `rtl.emit.keeping_sources` is
    open it is emitted anew.
    """
    make = emit or partial(units.emit, name)
    if sources_are_kept():
        return make(config)
    parameters = config.with_(name="any")  # machines that differ only in their name share one entry
    key = hashlib.sha256(f"{_sources_digest()} {parameters!r}".encode()).hexdigest()[:16]
    path = FOLDER / f"{name}-{key}.v"
    if not path.exists():
        with phase(f"emitting the Verilog of {name}"):
            text = make(config)
        path.parent.mkdir(parents=True, exist_ok=True)
        scratch = path.with_suffix(f".{os.getpid()}.tmp")
        scratch.write_text(text)
        scratch.replace(path)
    return path.read_text()


def forget_emitted() -> None:
    """Clears the caches of the benches, whose Verilog may be of the other kind: with the sources in it, or without."""
    for name, module in list(sys.modules.items()):
        if name.startswith("tb.") and module is not None:
            for value in vars(module).values():
                if callable(getattr(value, "cache_clear", None)) and getattr(value, "__module__", "").startswith("tb."):
                    value.cache_clear()


@cache
def _sources_digest() -> str:
    digest = hashlib.sha256(version("amaranth").encode())
    for path in sorted(path for folder in ("rtl", "spec") for path in (ROOT / folder).rglob("*.py")):
        digest.update(str(path.relative_to(ROOT)).encode() + path.read_bytes())
    return digest.hexdigest()
