"""Energies of operations as the study `energy_per_operation` measured them, kept in reports/energy_per_operation.json."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from spec.errors import InputError
from spec.paths import REPORTS

TABLE = REPORTS / "energy_per_operation.json"


@dataclass(frozen=True)
class Memory:
    """A unit's memory: its shape, and how often an operation reads and writes it."""

    words: int
    width: int
    reads: float
    writes: float


@dataclass(frozen=True)
class Unit:
    """A unit, or a part of one that is a module of its own.

    Attributes:
        name: of it.
        operation: what is counted: a field of `msv2.studies.energy.frame.WorkCounts`.
        dynamic_pj, switching_pj: of an operation, the second what nets take of it.
        clock_pj: of a cycle in which nothing happens.
        leakage_mw: always.
        memories: beside its logic.
        source: how it was measured.
        scales_with: field of the configuration by which clock and leakage of other machines are scaled; "" none.
    """

    name: str
    operation: str
    dynamic_pj: float
    switching_pj: float
    clock_pj: float
    leakage_mw: float
    memories: tuple[Memory, ...]
    source: str
    scales_with: str = ""


@dataclass(frozen=True)
class Table:
    """All units of a machine, at the node of the library.

    Attributes:
        units: each once.
        config: the machine's name; reference: its cores, culling units and lanes, by the field's name.
        node, voltage: of the library.
        to_16nm: factor of energy; scaling: what it is and from where.
        flop_leakage_pw: of a flip-flop.
        commit: of the measurement.
    """

    units: tuple[Unit, ...]
    config: str
    reference: Mapping[str, int]
    node: str
    to_16nm: float
    scaling: str
    flop_leakage_pw: float
    commit: str


def load_table(path: Path = TABLE) -> Table:
    """The table of a file; InputError where there is none or it is not one."""
    try:
        content = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is not a table of energies ({error}): the study energy_per_operation writes one") from error
    try:
        units = tuple(
            Unit(**{**row, "memories": tuple(Memory(**memory) for memory in row["memories"])}) for row in content["units"])
        return Table(units=units, **{name: content[name] for name in (
            "config", "reference", "node", "to_16nm", "scaling", "flop_leakage_pw", "commit")})
    except (KeyError, TypeError) as error:
        raise InputError(f"{path} must be what the study energy_per_operation writes, not a table without {error}") from error
