"""Writes the generated pages of docs/: formats, effects and registers.

    python -m msv2.document             writes them
    python -m msv2.document --check     fails if one is stale
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from pathlib import Path

from msv2.document import effects, formats, registers
from spec.errors import InputError, run_command_line

PAGES: dict[Path, Callable[[], str]] = formats.PAGES | effects.PAGES | registers.PAGES
"""What is generated, by path."""


def write(path: Path, make: Callable[[], str]) -> None:
    """Writes what `make` gives, whole or not at all."""
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    partial.write_text(make(), encoding="utf-8")
    partial.replace(path)


def check(path: Path, make: Callable[[], str]) -> None:
    """Raises InputError unless `path` holds what `make` gives now."""
    if not path.is_file() or path.read_text(encoding="utf-8") != make():
        raise InputError(f"{path} is stale: run `python -m msv2.document`")


def main(argv: Sequence[str] | None = None) -> None:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m msv2.document", description="Writes the generated pages of docs/.")
    parser.add_argument("--check", action="store_true", help="write nothing; exit status 2 if a page is stale")
    act = check if parser.parse_args(argv).check else write
    for path, make in PAGES.items():
        act(path, make)


if __name__ == "__main__":
    run_command_line(main)
