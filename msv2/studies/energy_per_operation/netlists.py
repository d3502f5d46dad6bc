"""Flattened mapped netlists of units, with the library's data of their cells."""

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
"""Modules whose adders are not optimised by slack: timing a million cells repeatedly would take an hour."""


@dataclass(frozen=True)
class Mapped:
    """The mapped netlist of a unit.

    Attributes:
        flat, cells, electrical: the flat netlist, its cells, and its electrical data.
        clock_ps: the clock for which it was made.
        area_um2: the area of its cells, with all modules.
    """

    flat: Flat
    cells: dict[str, Cell]
    electrical: Electrical
    clock_ps: float
    area_um2: float

    def simulation(self) -> Simulation:
        """A simulation of the netlist with gate delays. Inputs and the memories' data arrive at the times that timing
        assumes."""
        e = self.electrical
        return Simulation(self.flat, self.cells, Delays(
            _whole(e.gate_delay), _whole(e.flop_delay), round(INPUT_DELAY * self.clock_ps), round(MEMORY_READ * self.clock_ps)))


def _whole(delays: np.ndarray) -> np.ndarray:
    return np.maximum(np.rint(delays), 1).astype(np.int64)


def map_unit(component: wiring.Component, name: str, clock_ps: float, folder: Path) -> Mapped:
    """Synthesises a unit, or finds it in the cache in `folder`. Raises InputError where Yosys or liberty files are missing."""
    settings = Settings("asap7", clock_ps, folder)
    settings.check()
    design, parts = elaborate(component, name), {}
    for module in design.texts:  # modules come after those that they use
        below = [Path(part["netlist"]) for part in parts.values()]
        parts[module] = module_result(design, module, below, settings, is_timed=module not in UNTIMED)
    netlists = {module: Path(part["netlist"]) for module, part in parts.items()}
    cells = read_cells(find_files(ASAP7), _kinds(netlists) - netlists.keys())
    flat = Flattener(netlists, cells).flatten(name)
    counts = design.counts()
    return Mapped(flat, cells, analyse(flat, cells, ASAP7.load), clock_ps,
                  sum(counts[module] * part["area"] for module, part in parts.items()))


def _kinds(netlists: dict[str, Path]) -> set[str]:
    """All types of cells in the netlists."""
    return {cell["type"] for module, path in netlists.items()
            for cell in json.loads(path.with_suffix(".json").read_text())["modules"][module]["cells"].values()}
