"""Corners and margins under which a whole machine is timed (`synth.linked`).

The units' own synthesis and timing (`synth.timing`) keeps to the typical corner, so that areas stay comparable.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

from spec.errors import InputError
from synth.liberty import ASAP7, Technology, find_files, merge
from synth.scaling import FO4_PS

UNCERTAINTY = 0.05
"""Clock uncertainty of setup checks, as a share of the clock: jitter and skew."""

INPUT_SLEW_PS = 20.0
"""Transition time at the clock pin of the flip-flop that is assumed to drive an input, and of the ideal clock at 1 GHz."""

SLEW_LIMIT_PS = 320.0
"""Longest transition time: `max_transition` of ASAP7's pins."""

HOLD_UNCERTAINTY_PS = 0.0
"""Clock uncertainty of hold checks: both ends see the same edge, so jitter cancels, and skew is not known without a tree."""


@dataclass(frozen=True)
class Corner:
    """A corner: a name, its cells, and the factor from a memory's typical times to its times here, with the factor's source."""

    name: str
    technology: Technology
    memory_factor: float = 1.0
    source: str = ""

    def liberty(self, folder: Path) -> Path:
        """The merged liberty file, kept in `folder`/cache.

        Raises:
            InputError: the liberty files are missing.
        """
        if not self.technology.files[0].endswith((".lib", ".lib.gz")) or Path(self.technology.files[0]).is_absolute():
            return Path(self.technology.files[0])
        find_files(self.technology)
        key = hashlib.sha256(repr(self.technology).encode()).hexdigest()[:8]
        return merge(self.technology, folder / "cache" / f"{self.technology.name}-{key}.lib")


def _slow(technology: Technology) -> Technology:
    files = tuple(name.replace("asap7/", "asap7_ss/").replace("_TT_", "_SS_") for name in technology.files)
    return replace(technology, name="asap7_ss", node="ASAP7 7.5-track RVT, SS 0.63 V 100 C", files=files, package=None)


TYPICAL = Corner("typical", ASAP7)
SLOW = Corner("slow", _slow(ASAP7), FO4_PS["asap7_ss"] / FO4_PS["asap7"],
              "the macros have no slow corner: their times grow as the delay of an inverter with a fan-out of four does")

CORNERS = {corner.name: corner for corner in (TYPICAL, SLOW)}


def corner(name: str) -> Corner:
    """The corner of this name, or of the merged liberty file at this path, which must have ASAP7's cells.

    Raises:
        InputError: it is neither.
    """
    if name in CORNERS:
        return CORNERS[name]
    path = Path(name)
    if not path.name.endswith((".lib", ".lib.gz")) or not path.is_file():
        raise InputError(f"corner {name!r} is not known: {', '.join(CORNERS)} are, and a liberty file with ASAP7's cells")
    return Corner(path.name.split(".")[0], replace(ASAP7, name=path.name.split(".")[0], node=path.name,
                                                   files=(str(path.resolve()),)))

