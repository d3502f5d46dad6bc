"""A component as an and-inverter graph (AIGER): memories and registers as single bits, none of which has a value before reset.

A chip's registers hold anything when its power comes on, so initial values are removed. Registers that belong to the proof
keep theirs: Amaranth signals with the attribute `KEPT`. The contents of a memory that nobody writes are a table and are kept
as well.

Two things must not be changed here. Passes that simplify logic (`opt`, `wreduce`) may choose a convenient value for what is
undefined, which would prove what is false; only `opt_clean`, which removes what nothing reads, is used. And an AIGER file has
its outputs in an order of its own, so they are found by name in the file's map.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from amaranth.back import rtlil
from amaranth.hdl import Elaboratable, Signal, Value

from rtl.emit import Emission
from spec.errors import InputError
from spec.extras import how_to_get

KEPT = "formal_kept"
"""The attribute of signals whose initial values are kept."""

TOP = "proof"

TO_GATES = """
async2sync
dffunmap
opt_clean
setundef -zero -undriven
simplemap
techmap
simplemap
dfflegalize -cell $_DFF_P_ 01
aigmap
opt_clean
"""
"""From cells to AND gates, inverters and D flip-flops. `setundef` gives constants to wires that nothing drives, such as the
parts of a payload that a component does not use."""

PASSES = f"""
hierarchy -top {TOP}
proc
flatten
opt_clean
setattr -unset init w:* w:* a:{KEPT} %i %d
opt_clean
memory_dff
memory_collect
memory_map
opt_clean
{TO_GATES}"""
"""From RTLIL to gates, memories included."""

SECONDS = 300
"""Limit of Yosys' time."""

_RUN = "import sys\nfrom pyosys import libyosys as y\ny.run_pass('script ' + sys.argv[1], y.Design())"
"""Yosys in a process of its own, which ends where it meets an error."""


@dataclass(frozen=True)
class Circuit:
    """A circuit in a file.

    Attributes:
        path: the AIGER file.
        outputs: position of each output in the file, by name.
        latches, ands: its size.
    """

    path: Path
    outputs: dict[str, int]
    latches: int
    ands: int


def find_abc() -> Path:
    """The program ABC of the package pyosys. Raises InputError where the package is not installed."""
    found = find_spec("pyosys")
    if found is None or found.origin is None:
        raise InputError(f"proofs need pyosys, which is not installed; {how_to_get('pyosys')}")
    return Path(found.origin).parent / "yosys-abc"


def without_contents(text: str) -> str:
    """RTLIL in which memories that are written have no initial contents; those that are only read keep theirs."""
    modules = re.split(r"(?m)^(?=module )", text)
    return "".join(_forget(module) for module in modules)


def _forget(module: str) -> str:
    cells = re.compile(r"(?ms)^  cell \$(mem\w+) [^\n]*\n.*?^  end\n")
    memory = re.compile(r'parameter \\MEMID "([^"]+)"')
    written = {memory.search(cell[0])[1] for cell in cells.finditer(module) if cell[1].startswith("memwr")}

    def kept(cell: re.Match[str]) -> str:
        return "" if cell[1].startswith("meminit") and memory.search(cell[0])[1] in written else cell[0]

    return cells.sub(kept, module)


def text_of(design: Elaboratable, inputs: Sequence[Value], outputs: Mapping[str, Signal]) -> str:
    """A design as RTLIL, without what memories hold when the power comes on.

    Args:
        design: the design, with a clock domain `sync`, the only one.
        inputs: what has any value in every cycle, and the clock.
        outputs: signals of one bit, by their names.
    """
    emission = Emission()
    top = rtlil.convert(design, name=TOP, ports=[*inputs, *outputs.values()], platform=emission, emit_src=False)
    return without_contents("\n".join([*emission.modules.values(), top]))


def to_circuit(text: str, outputs: Sequence[str], folder: Path) -> Circuit:
    """Writes RTLIL as AIGER into `folder`.

    Raises:
        InputError: pyosys is not installed.
        RuntimeError: Yosys failed; the message ends with what it said.
    """
    find_abc()
    folder.mkdir(parents=True, exist_ok=True)
    source, script, aiger, names = (folder / f"circuit.{kind}" for kind in ("il", "ys", "aig", "map"))
    source.write_text(text)
    write = f"write_aiger -zinit -no-sort -symbols -map {names.name} {aiger.name}"
    script.write_text(f"read_rtlil {source.name}\n{PASSES}{write}\n")
    run = subprocess.run([sys.executable, "-c", _RUN, script.name], capture_output=True, text=True, timeout=SECONDS, cwd=folder,
                         check=False)
    if run.returncode:
        raise RuntimeError(f"Yosys failed with {run.returncode}: {(run.stdout + run.stderr)[-1000:]}")
    found = {line.split()[3].lstrip("\\"): int(line.split()[1]) for line in names.read_text().splitlines()
             if line.startswith("output")}
    header, literals = _read(aiger)
    unnamed = sorted(set(range(len(literals))) - set(found.values()))
    if any(literals[place] for place in unnamed) or len(literals) != len(outputs):
        raise RuntimeError(f"the map of {aiger} must name every output that is not constantly 0")
    constant = iter(unnamed)
    places = {name: found[name] if name in found else next(constant) for name in outputs}
    return Circuit(aiger, places, header[2], header[4])


def _read(aiger: Path) -> tuple[list[int], list[int]]:
    """The numbers in the header of an AIGER file, and the literal of each output; 0 is the constant 0."""
    with aiger.open("rb") as file:
        header = [int(word) for word in file.readline().split()[1:]]
        for _ in range(header[2]):
            file.readline()
        return header, [int(file.readline()) for _ in range(header[3])]
