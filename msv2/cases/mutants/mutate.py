"""Mutants of a circuit, by Yosys' command `mutate`: all of them in one Verilog module, of which a number selects one.

A mutant inverts one bit of one port of one cell, ties it to 0 or 1, or inverts it where another bit is 0 or 1. Mutants are
drawn so that they cover as many lines of Python as possible. Where a testbench is part of the circuit, only cells that a line
of `rtl/` made are mutated, so that the testbench stays sound.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rtl.emit import verilog_of
from rtl.units import UNITS
from spec.errors import InputError
from spec.paths import ROOT

SELECT = "mutant"
"""The register that selects a mutant; 0 stands for the sound circuit."""

SELECT_BITS = 12

SECONDS = 900
"""Limit of Yosys' time."""

_RUN = "import sys\nfrom pyosys import libyosys as y\ny.run_pass('script ' + sys.argv[1], y.Design())"

_CHOSEN = "t:$mem* %d t:$scopeinfo %d"


@dataclass(frozen=True)
class Mutant:
    """A mutant: its number from 1 on, Yosys' command, and the lines of Python that made the cell."""

    number: int
    command: str
    lines: tuple[str, ...]

    @property
    def words(self) -> str:
        """What is changed: the mode, the cell's port and bit, and the named wire if there is one."""
        word = dict(re.findall(r"-(\w+) (\S+)", self.command))
        place = f"{word['port']}[{word['portbit']}] of {word['cell'].lstrip(chr(92))}"
        wire = f" ({word['wire']}[{word['wirebit']}])" if "wire" in word else ""
        return f"{word['mode']} {place}{wire}"


def yosys(script: str, folder: Path) -> None:
    """Runs a script of Yosys in a folder, in a process of its own.

    Raises:
        RuntimeError: Yosys failed; the message ends with what it said.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "script.ys").write_text(script)
    run = subprocess.run([sys.executable, "-c", _RUN, "script.ys"], capture_output=True, text=True, timeout=SECONDS, cwd=folder,
                         check=False)
    if run.returncode:
        raise RuntimeError(f"Yosys failed with {run.returncode}: {(run.stdout + run.stderr)[-1000:]}")


def draw(text: str, module: str, count: int, seed: int, folder: Path, apart: Sequence[str] = ()) -> list[Mutant]:
    """Draws mutants of a circuit and leaves it, flattened, as `flat.il` in the folder.

    Args:
        text: RTLIL of the circuit and of all modules below it, with attributes `src`.
        module: the top module.
        count: how many mutants; there are fewer where the circuit has fewer. Mutants of clocks are left out.
        apart: parts of the names of instances whose cells are left out as well.
    """
    if count < 1 or count >= 1 << SELECT_BITS:
        raise InputError(f"{count} mutants are not accepted: a number from 1 to {(1 << SELECT_BITS) - 1} is")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "unit.il").write_text(text)
    cells = "c:*" if module in UNITS else "a:src=*/rtl/*"
    yosys(f"""\
read_rtlil unit.il
hierarchy -top {module}
proc
flatten
opt_clean
select -set chosen {cells} {_CHOSEN} {" ".join(f"c:*{name}* %d" for name in apart)}
write_rtlil flat.il
mutate -list {count} -seed {seed} -o mutants.txt @chosen
""", folder)
    lines = (folder / "mutants.txt").read_text().splitlines()
    commands = (line for line in lines if line.startswith("mutate ") and " -port CLK " not in line)
    return [Mutant(number, command, _lines(command)) for number, command in enumerate(commands, 1)]


def _lines(command: str) -> tuple[str, ...]:
    """The lines of Python that made a cell, the innermost last: paths of the project, and of Amaranth's library."""
    found = re.findall(r"([^\s|]+\.py:\d+)", " ".join(re.findall(r"-src (\S+)", command)))
    shown = (line.rpartition("/site-packages/")[2].removeprefix(f"{ROOT}/") for line in found)
    return tuple(dict.fromkeys(shown))


def applied(mutants: Sequence[Mutant]) -> str:
    """Commands of Yosys that put the mutants into the design, each behind its number at the input SELECT."""
    return "".join(f"{mutant.command} -ctrl {SELECT} {SELECT_BITS} {mutant.number}\n" for mutant in mutants)


def verilog_with(mutants: Sequence[Mutant], text: str, module: str, verilog: str, folder: Path) -> str:
    """Verilog in which the unit is replaced by the one with all its mutants.

    Args:
        text, module: the unit, as for `draw`, which was called with this folder.
        verilog: Verilog that contains the unit as `rtl.emit` writes it.

    Raises:
        ValueError: `verilog` does not contain the unit.
    """
    yosys(f"read_rtlil flat.il\n{applied(mutants)}opt_clean\nwrite_verilog -noattr mutants.v\n", folder)
    original = verilog_of(text)
    if verilog.count(original) != 1:
        raise ValueError(f"the Verilog of {module} must be in the testbench once")
    made = (folder / "mutants.v").read_text()
    return verilog.replace(original, _selected(made[made.index("module "):]))


def _selected(verilog: str) -> str:
    """The module with a register that the simulation writes in place of the input SELECT."""
    head, rest = verilog.split(");", 1)
    head = re.sub(rf",\s*{SELECT}\b|\b{SELECT}\s*,", "", head)
    register = f"reg [{SELECT_BITS - 1}:0] {SELECT} /*verilator public_flat_rw*/ = 0;\n"
    rest, inputs = re.subn(rf"  input \[{SELECT_BITS - 1}:0\] {SELECT};\n", register, rest)
    rest, wires = re.subn(rf"  wire \[{SELECT_BITS - 1}:0\] {SELECT};\n", "", rest)
    if (inputs, wires) != (1, 1):
        raise ValueError(f"the input {SELECT} must be declared once, not {(inputs, wires)!r}")
    return f"{head});{rest}"
