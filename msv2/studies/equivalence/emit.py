"""Emits the RTLIL of every unit from the sources of a commit."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from spec.errors import InputError
from spec.paths import ROOT

_EMIT = """
import sys
from pathlib import Path
from rtl.emit import to_rtlil
from rtl.top.machine import Machine
from spec.config import CONFIGS
try:
    from rtl.units import UNITS
except ImportError:  # where the registry was before version 0.2
    from synth.units import UNITS
out, *names = sys.argv[1:]
for name in names:
    config = CONFIGS[name]
    units = {unit: UNITS[unit].make(config) for unit in UNITS}
    machines = {"machine": Machine(config)}
    if getattr(config, "lists", "tile") == "tile":
        machines["machine_stereo"] = Machine(config.with_(stereo=True))
    for unit, component in {**units, **machines}.items():
        (Path(out) / f"{name}.{unit}.il").write_text(to_rtlil(component, unit))
"""
"""The program that emits the units. It runs with the sources of the commit, and asks the registry of units there."""


@contextmanager
def checked_out(commit: str) -> Iterator[Path]:
    """A temporary folder with the files of a commit.

    Raises:
        InputError: there is no such commit, or the project is no git checkout.
    """
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "sources"
        command = ["git", "worktree", "add", "--detach", str(place), commit]
        added = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
        if added.returncode:
            raise InputError(f"commit {commit!r} is not accepted: git says {added.stderr.strip().splitlines()[-1]}")
        try:
            yield place
        finally:
            subprocess.run(["git", "worktree", "remove", "--force", str(place)], cwd=ROOT, capture_output=True)


def emitted(sources: Path, configs: tuple[str, ...], out: Path) -> dict[str, Path]:
    """The RTLIL files of all units of the configurations, by `CONFIG.UNIT`, emitted from the project in `sources`.

    Raises:
        InputError: these sources cannot emit them.
    """
    out.mkdir(parents=True, exist_ok=True)
    for old in out.glob("*.il"):
        old.unlink()
    done = subprocess.run([sys.executable, "-c", _EMIT, str(out), *configs], cwd=sources)
    if done.returncode:
        raise InputError(f"the sources in {sources} do not emit {', '.join(configs)} (the message is above)")
    return {path.stem: path for path in sorted(out.glob("*.il"))}


def canonical(text: str) -> str:
    """The RTLIL with its private names numbered in the order of their appearance, since their generated numbers are
    arbitrary."""
    names: dict[str, str] = {}

    def renamed(match: re.Match[str]) -> str:
        name = match[0]
        return name if re.fullmatch(r"\$[a-z_]+[a-z0-9_]*", name) else names.setdefault(name, f"$n{len(names)}")

    return re.sub(r"\$[^\s\]\[{}]+", renamed, text)
