"""`msv2 study list` lists the studies. `msv2 study run NAME ...` runs a study; the word `run` can be omitted.

`msv2 study run NAME --help` shows the options of a study.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from msv2.studies.catalogue import list_studies, run_study
from spec.errors import run_command_line


def main(argv: Sequence[str] | None = None) -> int:
    """Lists the studies, or runs the study that the first argument names; the other arguments go to the study.

    Returns:
        The exit status.

    Raises:
        InputError: no study is named, or there is no study of this name.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments[:1] == ["list"]:
        return list_studies(arguments[1:])
    return run_study(arguments[1:] if arguments[:1] == ["run"] else arguments)


if __name__ == "__main__":
    run_command_line(main)
