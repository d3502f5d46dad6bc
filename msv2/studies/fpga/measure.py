"""Synthesises one unit for one family of FPGAs and prints its cells by type, as JSON. The study runs this as a process.

    python -m msv2.studies.fpga.measure UNIT CONFIG FAMILY FOLDER

The process limits itself to `CPU_SECONDS` and `MEMORY_GB`, since a memory that fits no block of the family is built of
flip-flops and multiplexers, which can take hours and more memory than a computer has.
"""

from __future__ import annotations

import json
import resource
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rtl import units
from rtl.emit import to_rtlil
from spec.config import CONFIGS
from synth import flow

CPU_SECONDS = 120
"""Most processor seconds of a unit. Yosys and ABC are two processes, and each may take as many."""

MEMORY_GB = 6
"""Most memory of each of the two processes."""


COMMANDS = ("proc", "flatten -noscopeinfo", "opt_clean -purge")
"""What is done before the family's own command. Where inner modules are left to that, Yosys 0.70 ends in an assertion when
it takes ABC's result back."""


@dataclass(frozen=True)
class Family:
    """A family of FPGAs and how its cells are counted.

    Attributes:
        title: its name in tables.
        command: Yosys' command, which is given `-top UNIT`.
        lut, lut_ram, ff, bram, dsp: what each type of cell takes: LUTs of logic, LUTs as memory, flip-flops, blocks of memory
            of 18 Kbit, and multipliers.
        free: types of cells that take no LUT: multiplexers and carry chains beside the LUTs, buffers, constants.
    """

    title: str
    command: str
    lut: Mapping[str, int]
    lut_ram: Mapping[str, int]
    ff: Mapping[str, int]
    bram: Mapping[str, int]
    dsp: Mapping[str, int]
    free: frozenset[str]

    def count(self, cells: Mapping[str, int]) -> dict[str, int]:
        """The sums by column. Raises ValueError where a type of cell is not known, which would be missing from every sum."""
        columns = {name: getattr(self, name) for name in COLUMNS}
        unknown = set(cells) - set(self.free) - set().union(*columns.values())
        if unknown:
            raise ValueError(f"cells of {self.title} must be known, not {', '.join(sorted(unknown))}")
        return {name: sum(weight * cells.get(kind, 0) for kind, weight in kinds.items()) for name, kinds in columns.items()}


COLUMNS = ("lut", "lut_ram", "ff", "bram", "dsp")

FAMILIES = {
    "ecp5": Family(
        "ECP5", "synth_ecp5",
        lut={"LUT4": 1, "CCU2C": 2}, lut_ram={"TRELLIS_DPR16X4": 6}, ff={"TRELLIS_FF": 1}, bram={"DP16KD": 1, "PDPW16KD": 1},
        dsp={"MULT18X18D": 1}, free=frozenset({"PFUMX", "L6MUX21"})),
    "xc7": Family(
        "7-series", "synth_xilinx -family xc7 -noiopad",
        lut={f"LUT{inputs}": 1 for inputs in range(1, 7)} | {"INV": 1},
        lut_ram={"RAM32M": 4, "RAM32X1D": 2, "RAM64M": 4, "RAM64X1D": 2, "RAM128X1D": 4, "RAM64X1S": 1, "RAM128X1S": 2,
                 "RAM256X1S": 4, "SRL16E": 1, "SRLC32E": 1},
        ff={"FDRE": 1, "FDSE": 1, "FDCE": 1, "FDPE": 1}, bram={"RAMB18E1": 1, "RAMB36E1": 2},
        dsp={"DSP48E1": 1}, free=frozenset({"CARRY4", "MUXF7", "MUXF8", "MUXF9", "BUFG", "VCC", "GND"})),
}
"""The families by the names that the command line takes."""


def cells_of(unit: str, config: str, family: str, folder: Path) -> dict[str, int]:
    """The number of cells of each type in a unit's flat netlist; Yosys' log is written into the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    label = f"{unit}-{config}-{family}"
    source, statistics = folder / f"{label}.il", folder / f"{label}.stat"
    source.write_text(to_rtlil(units.named(unit).make(CONFIGS[config]), unit))
    flow.run(f"read_rtlil {source}", f"hierarchy -top {unit}", *COMMANDS, f"{FAMILIES[family].command} -top {unit}",
             f"tee -q -o {statistics} stat -top {unit} -json", log=folder / f"{label}.log")
    return json.loads(statistics.read_text())["modules"][f"\\{unit}"]["num_cells_by_type"]


def main(argv: Sequence[str]) -> int:
    """Measures one unit; arguments as in the module's description."""
    unit, config, family, folder = argv
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_SECONDS, CPU_SECONDS))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_GB << 30, MEMORY_GB << 30))
    cells = cells_of(unit, config, family, Path(folder))
    print(json.dumps(dict(sorted(cells.items()))))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
