"""`msv2 study list` lists the studies; `msv2 study run NAME ...`, or without `run`, runs one; NAME --help shows its options."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from msv2.studies.catalogue import list_studies, run_study
from spec.errors import run_command_line


def main(argv: Sequence[str] | None = None) -> int:
    """Lists the studies, or runs the one that the first argument names with the others; returns the exit status.

    Raises:
        InputError: no study is named, or there is none of this name.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments[:1] == ["list"]:
        return list_studies(arguments[1:])
    return run_study(arguments[1:] if arguments[:1] == ["run"] else arguments)


if __name__ == "__main__":
    run_command_line(main)
