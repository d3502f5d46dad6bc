"""A cache of emitted Verilog. Emission takes seconds, and the emitted text is needed in every session because it decides
whether a simulator must be rebuilt."""
from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from functools import cache
from importlib.metadata import version

from spec.config import AcceleratorConfig
from spec.paths import ROOT

FOLDER = ROOT / "build" / "emitted"


def emitted(name: str, config: AcceleratorConfig, emit: Callable[[AcceleratorConfig], str]) -> str:
    """The text of `emit(config)`, read from build/emitted if rtl/, spec/, Amaranth and the configuration have not changed."""
    parameters = config.with_(name="any")  # machines that differ only in their name share one entry
    key = hashlib.sha256(f"{_sources_digest()} {parameters!r}".encode()).hexdigest()[:16]
    path = FOLDER / f"{name}-{key}.v"
    if not path.exists():
        text = emit(config)
        path.parent.mkdir(parents=True, exist_ok=True)
        scratch = path.with_suffix(f".{os.getpid()}.tmp")
        scratch.write_text(text)
        scratch.replace(path)
    return path.read_text()


@cache
def _sources_digest() -> str:
    digest = hashlib.sha256(version("amaranth").encode())
    for path in sorted(path for folder in ("rtl", "spec") for path in (ROOT / folder).rglob("*.py")):
        digest.update(str(path.relative_to(ROOT)).encode() + path.read_bytes())
    return digest.hexdigest()
