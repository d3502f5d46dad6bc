"""`python -m msv2.studies NAME ...`: runs one study; `--help` after the name shows its options."""

from __future__ import annotations

import difflib
import importlib
import sys
from collections.abc import Sequence
from pathlib import Path

from spec.errors import InputError, run_command_line

NAMES = tuple(sorted(path.parent.name for path in Path(__file__).parent.glob("*/study.py")))
"""The names of the studies: every folder of this package that holds a module `study`."""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the study that the first argument names, with the remaining arguments; returns its exit status.

    Raises:
        InputError: no study is named, or there is none of this name.
    """
    name, *rest = sys.argv[1:] if argv is None else argv or [""]
    if name in ("-h", "--help"):
        print(f"{__doc__}\n\nstudies: {', '.join(NAMES)}")
        return 0
    if name not in NAMES:
        near = difflib.get_close_matches(name, NAMES, 1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise InputError(f"study {name!r} is not accepted: choose one of {', '.join(NAMES)}{hint}")
    return importlib.import_module(f"msv2.studies.{name}.study").main(rest) or 0


if __name__ == "__main__":
    run_command_line(main)
