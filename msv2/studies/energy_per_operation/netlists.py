"""Mapped netlists of units, flat, with what the library says of their cells."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from amaranth.lib import wiring

from synth.design import elaborate
from synth.liberty import ASAP7, find_files
from synth.power.cells import Cell, read_cells
from synth.power.electrical import Electrical, analyse
from synth.power.netlist import Flat, Flattener
from synth.power.simulate import Delays, Simulation
from synth.report import module_result
from synth.settings import Settings
from synth.timing import INPUT_DELAY, MEMORY_READ

UNTIMED = ("vrc_array",)
"""Modules whose sums are not cut by the slack: timing a million cells again and again would take an hour."""


@dataclass(frozen=True)
class Mapped:
    """A unit's netlist.

    Attributes:
        flat, cells, electrical: of the netlist.
        clock_ps: that it was made for.
        area_um2: of its cells, all modules together.
    """

    flat: Flat
    cells: dict[str, Cell]
    electrical: Electrical
    clock_ps: float
    area_um2: float

    def simulation(self) -> Simulation:
        """Its state, with the delays of its gates; inputs and memories' data come when timing says so."""
        e = self.electrical
        return Simulation(self.flat, self.cells, Delays(
            _whole(e.gate_delay), _whole(e.flop_delay), round(INPUT_DELAY * self.clock_ps), round(MEMORY_READ * self.clock_ps)))


def _whole(delays: np.ndarray) -> np.ndarray:
    return np.maximum(np.rint(delays), 1).astype(np.int64)


def map_unit(component: wiring.Component, name: str, clock_ps: float, folder: Path) -> Mapped:
    """Synthesises a unit, or finds it in the cache below `folder`; InputError where Yosys or liberty files are absent."""
    settings = Settings("asap7", clock_ps, folder)
    settings.check()
    design, parts = elaborate(component, name), {}
    for module in design.texts:  # lower ones first
        below = [Path(part["netlist"]) for part in parts.values()]
        parts[module] = module_result(design, module, below, settings, is_timed=module not in UNTIMED)
    netlists = {module: Path(part["netlist"]) for module, part in parts.items()}
    cells = read_cells(find_files(ASAP7), _kinds(netlists) - netlists.keys())
    flat = Flattener(netlists, cells).flatten(name)
    counts = design.counts()
    return Mapped(flat, cells, analyse(flat, cells, ASAP7.load), clock_ps,
                  sum(counts[module] * part["area"] for module, part in parts.items()))


def _kinds(netlists: dict[str, Path]) -> set[str]:
    """All types of cells."""
    return {cell["type"] for module, path in netlists.items()
            for cell in json.loads(path.with_suffix(".json").read_text())["modules"][module]["cells"].values()}
