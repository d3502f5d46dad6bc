"""Runs OpenSTA once for the same commands on the same files: its output is kept beside the script."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path

from spec.private import locked
from synth import timing
from synth.report import write_text


def run_once(commands: str, files: Iterable[Path], folder: Path, name: str) -> str:
    """The output of OpenSTA for a script that reads these files, from an earlier run if there was one.

    Raises:
        RuntimeError: OpenSTA failed.
    """
    state = hashlib.sha256(commands.encode())
    for path in files:
        state.update(path.read_bytes())
    kept = folder / f"{name}-{state.hexdigest()[:16]}.out"
    with locked(folder / f"{name}.lock"):
        if not kept.exists():
            write_text(kept, timing.run_sta(commands, folder, name))
    return kept.read_text()
