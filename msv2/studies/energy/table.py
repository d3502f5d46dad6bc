"""The energies of operations that the study `energy_per_operation` measured, from reports/energy_per_operation.json."""

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
    """A memory of a unit: its shape, and how often an operation reads and writes it."""

    words: int
    width: int
    reads: float
    writes: float


@dataclass(frozen=True)
class Unit:
    """A unit, or a part of one that is a module of its own.

    Attributes:
        name: the unit's name.
        operation: the operation that is counted, a field of `msv2.studies.energy.frame.WorkCounts`.
        dynamic_pj, switching_pj: the energy of an operation, and the part of it that nets take.
        clock_pj: the energy of a cycle in which nothing happens.
        leakage_mw: the leakage power.
        memories: the memories besides the unit's logic.
        source: how the energies were measured.
        scales_with: the field of the configuration with which clock and leakage scale; "" for none.
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
    """The energies of all units of a machine, at the node of the library.

    Attributes:
        units: the units, each once. supertile_units: those that only machines with lists by super-tile have.
        config: the machine's name; reference: its numbers of cores, culling units and lanes, by the field's name.
        node, voltage: of the library.
        to_16nm: the factor of energy to 16 nm; scaling: what it is and where it comes from.
        flop_leakage_pw: the leakage of a flip-flop.
        commit: the commit that was measured.
    """

    units: tuple[Unit, ...]
    config: str
    reference: Mapping[str, int]
    node: str
    to_16nm: float
    scaling: str
    flop_leakage_pw: float
    commit: str
    supertile_units: tuple[Unit, ...] = ()


def load_table(path: Path = TABLE) -> Table:
    """The table in a file. Raises InputError where the file is missing or is not a table."""
    try:
        content = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is not a table of energies ({error}): the study energy_per_operation writes one") from error
    try:
        units, more = (tuple(
            Unit(**{**row, "memories": tuple(Memory(**memory) for memory in row["memories"])}) for row in content[key])
            for key in ("units", "supertile_units"))
        return Table(units=units, supertile_units=more, **{name: content[name] for name in (
            "config", "reference", "node", "to_16nm", "scaling", "flop_leakage_pw", "commit")})
    except (KeyError, TypeError) as error:
        raise InputError(f"{path} must be what the study energy_per_operation writes, not a table without {error}") from error
