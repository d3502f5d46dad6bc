"""The process that loads spoilt files, case after case, within a limit of memory. `msv2.cases.fuzz.runs` starts it.

It reads a JSON object a line from standard input, `format`, `seed` and `index` of a case, and answers with a line for each:
`outcome` is one of OUTCOMES, `what` the exception of a failure, `where` its innermost place in the project, and `trace` the end
of its traceback.
"""

from __future__ import annotations

import json
import resource
import sys
import traceback
import warnings
import zlib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from msv2.cases.fuzz.samples import FORMATS
from msv2.cases.fuzz.spoil import spoil_file
from spec.errors import InputError
from spec.paths import ROOT

OUTCOMES = ACCEPTED, REFUSED, FAILED = "accepted", "refused", "failed"
"""A file was loaded; it was refused with an error that names what is wrong; or anything else happened."""

MEMORY = 1 << 30
"""Bytes that a case may take beyond what the process has when it starts."""


@cache
def good_files(name: str) -> Mapping[str, bytes]:
    """The good sample of a format."""
    return FORMATS[name].files()


def case_files(name: str, seed: int, index: int) -> dict[str, bytes]:
    """The files of a case: those of the sample, one of them spoilt. Case 0 is the good sample.

    Args:
        name: the format. seed, index: the case; the same numbers give the same files.
    """
    files = dict(good_files(name))
    if index:
        rng = np.random.default_rng([seed, zlib.crc32(name.encode()), index])
        chosen = list(files)[rng.integers(len(files))]
        if rng.random() < 0.02:
            del files[chosen]
        else:
            files[chosen] = spoil_file(chosen, files[chosen], rng)
    return files


def write_files(files: Mapping[str, bytes], folder: Path) -> None:
    """Writes the files of a case into a folder."""
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)


def run_case(name: str, seed: int, index: int) -> dict[str, Any]:
    """Loads the files of a case and says what happened."""
    with TemporaryDirectory() as folder:
        write_files(case_files(name, seed, index), Path(folder))
        try:
            FORMATS[name].read(Path(folder))
        except InputError:
            return {"outcome": REFUSED}
        except Exception as error:  # whatever it is, it is what the fuzzer looks for
            return {"outcome": FAILED, "what": f"{type(error).__name__}: {error!s:.200}", "where": _place(error),
                    "trace": traceback.format_exc()[-2000:]}
    return {"outcome": ACCEPTED}


def _place(error: BaseException) -> str:
    """File and line of the innermost place in the project."""
    places = [frame for frame in traceback.extract_tb(error.__traceback__) if Path(frame.filename).is_relative_to(ROOT)
              and "site-packages" not in frame.filename]
    return f"{Path(places[-1].filename).relative_to(ROOT)}:{places[-1].lineno}" if places else "?"


def _limit_memory() -> None:
    pages = Path("/proc/self/statm")
    if pages.exists():
        mapped = int(pages.read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (mapped + MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))


def main() -> None:
    """Serves cases until standard input ends."""
    warnings.simplefilter("ignore")
    for line in sys.stdin:
        case = json.loads(line)
        if case["index"] == 0:  # a format's first case: what it needs is imported before the limit counts
            run_case(case["format"], case["seed"], 0)
            _limit_memory()
        answer = run_case(case["format"], case["seed"], case["index"])
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
