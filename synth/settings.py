"""The settings of a synthesis: technology, clock, effort, and the folder for results."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from spec.errors import InputError
from spec.extras import how_to_get
from synth import flow
from synth.discover import discover
from synth.liberty import ASAP7, LIBRARIES, Technology, find_files, merge
from synth.memories import LIMIT

TECHNOLOGIES = ("generic", "asap7", *LIBRARIES)
"""Names of technologies; the path of a liberty file is accepted as well."""

MOST_RUNS = 6
"""Largest number of runs of a module until its clock is met, unless fewer are asked for."""


@dataclass(frozen=True)
class Settings:
    """The settings of a synthesis.

    Attributes:
        technology: one of TECHNOLOGIES, or the path of a liberty file.
        clock_ps: clock period in ps.
        folder: folder of the results and their cache.
        memory_limit: bits of the largest memory that is built of flip-flops.
        runs: how often a module is synthesised at most, with faster sums each time; with 1 all sums are fast from the start,
            which takes more area.
        exact: do not reuse results that were made with more runs; needed if areas of modules are compared.
    """

    technology: str
    clock_ps: float
    folder: Path
    memory_limit: int = LIMIT
    runs: int = MOST_RUNS
    exact: bool = False

    @property
    def label(self) -> str:
        """The technology's name as used in file names."""
        return self.technology if self.technology in TECHNOLOGIES else Path(self.technology).name.split(".")[0]

    def check(self) -> None:
        """Raises InputError if a value is not accepted, or if Yosys or liberty files are missing."""
        if self.technology not in TECHNOLOGIES and not self.technology.endswith((".lib", ".lib.gz")):
            raise InputError(f"technology {self.technology!r} is not known: {', '.join(TECHNOLOGIES)} are, and files *.lib")
        if not 1 <= self.clock_ps <= 1e6:
            raise InputError(f"a clock of {self.clock_ps!r} ps is not accepted: 1 to 1,000,000 is")
        if self.runs < 1:
            raise InputError(f"runs must be at least 1, not {self.runs!r}")
        if flow.libyosys is None:
            raise InputError(f"pyosys is not installed; {how_to_get('pyosys')}")
        if self.technology != "generic":
            self.library()

    def library(self) -> tuple[Technology, Path]:
        """The cell library and its merged liberty file."""
        cache = self.folder / "cache"
        if self.technology != ASAP7.name:
            return discover(self.technology, cache)
        find_files(ASAP7)
        return ASAP7, merge(ASAP7, cache / f"asap7-{hashlib.sha256(repr(ASAP7).encode()).hexdigest()[:8]}.lib")
