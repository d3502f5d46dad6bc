"""What no netlist shows of a chip's energy, measured elsewhere: wires, clock tree, and the other library's word on 16 nm.

The numbers are those of reports/wires.json (five placed units) and reports/energy_anchors.json (the same units mapped to two
libraries). They are of units, and taken for the whole machine.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache

from spec.errors import InputError
from spec.paths import REPORTS

WIRES, ANCHORS = REPORTS / "wires.json", REPORTS / "energy_anchors.json"


@dataclass(frozen=True)
class Share:
    """A share over all units, and the smallest and the largest of a unit."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Estimates:
    """The estimates.

    Attributes:
        wires: the load of wires over that of the pins that they lead to.
        clock_tree: the energy of the tree in front of clock pins over that of the pins and the cells behind them.
        anchor: energy of a unit at 16 nm by Nangate45 over that by ASAP7, in which operations are measured.
    """

    wires: Share
    clock_tree: Share
    anchor: Share


@cache
def estimates() -> Estimates:
    """The estimates of the kept reports.

    Raises:
        InputError: a report is missing, or is none.
    """
    def share(report: dict, value: str, of_unit: str) -> Share:
        units = [row[of_unit] for row in report["units"]]
        return Share(report[value], min(units), max(units))

    try:
        wires, anchors = (json.loads(path.read_text()) for path in (WIRES, ANCHORS))
        return Estimates(share(wires, "wire_share", "wire_share"), share(wires, "tree_share", "tree_share"),
                         share(anchors, "ratio", "ratio"))
    except (OSError, ValueError, KeyError) as error:
        raise InputError(
            f"{WIRES.name} and {ANCHORS.name} in {REPORTS} must be reports of placed units and of two libraries ({error}): "
            "`msv2 study run wires --keep` and `msv2 study run energy_anchors --keep` make them") from error
