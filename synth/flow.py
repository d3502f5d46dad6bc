"""The flow: synthesises one module to a netlist of library cells and reports its area. Modules below it are black boxes.

Modules are synthesised one by one, because in a flat netlist ABC would chain the carries of different sums through its own
gates. Sums are built from the library's full adders first (`synth.adders`), so that ABC sees only the logic between them.
"""

from __future__ import annotations

import importlib.metadata
import json
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TypeVar

try:
    from pyosys import libyosys
except ImportError:  # an optional dependency; its absence is reported when something is to be synthesised
    libyosys = None

from synth.adders import map_adders
from synth.broadcast import buffer_broadcasts
from synth.heap import Cut
from synth.liberty import Technology
from synth.loads import Pins, pins_of
from synth.memories import LIMIT, Macro, take_out
from synth.quiet import printing_to
from synth.sizing import resize

Result = TypeVar("Result")

ABC_SCRIPT = "strash; {1}dch; amap -m; topo; buffer -c -N 16; upsize -D {0:.0f}; dnsize -D {0:.0f}"
"""ABC first minimises area. Then it inserts buffers and sizes gates between two adders for a share of the clock, so that no
single gate is slow."""

BALANCE = "if -g -K 6; strash; "
"""Makes trees of chains of gates, such as those of comparisons, which takes a little more area."""

ABC_SHARE = 0.15
"""The share of the clock for logic between two adders."""

SOURCES = ("adders", "broadcast", "flow", "heap", "loads", "mapping", "memories", "sizing", "timing")
"""Modules of this package that a netlist depends on; the description of the library is hashed separately."""

NAND2_FLOP = 6.0
"""Area of a flip-flop in two-input NAND gates."""


@dataclass(frozen=True)
class Netlist:
    """The result of the synthesis of a module.

    Attributes:
        verilog: the netlist.
        area: area without the modules below, in the library's unit; NAND2 equivalents for the generic technology.
        cells: number of library cells of each type.
        memories: number of memories of each shape that were taken out of the logic.
        stores: all memories with their names, those taken out and those left.
        sums: by name, how each sum without a hint was built.
    """

    verilog: Path
    area: float
    cells: dict[str, int]
    memories: dict[Macro, int]
    stores: list[dict[str, object]]
    sums: dict[str, Cut]


def version() -> str:
    """The version of Yosys."""
    return "pyosys " + importlib.metadata.version("pyosys")


def run(*commands: str, log: Path, design: object = None) -> object:
    """Run Yosys commands on a design; what they print is appended to the file `log`."""
    design = design or libyosys.Design()
    with printing_to(log):
        for command in commands:
            libyosys.run_pass(command, design)
    return design


def _elaborate(rtlil: str, top: str, boxes: Sequence[str], folder: Path) -> object:
    folder.mkdir(parents=True, exist_ok=True)
    source = folder / f"{top}.il"
    source.write_text(rtlil)
    return run(f"read_rtlil {source}", *(f"blackbox {box}" for box in boxes), f"hierarchy -top {top}", "proc",
               "attrmap -remove init", "flatten", "opt", *_if_memories(rtlil, "memory_collect"), log=folder / "yosys.log")


def _if_memories(rtlil: str, *commands: str) -> tuple[str, ...]:
    """The commands if the design has memories, otherwise none: each pass numbers objects, which would change other results."""
    return commands if "$memrd" in rtlil else ()


def synthesise(
    rtlil: str, top: str, technology: Technology, liberty: Path, folder: Path,
    blocks: Mapping[str, Sequence[int]], boxes: Sequence[str] = (), budgets: Mapping[str, float] | None = None,
    memory_limit: int = LIMIT, clock_ps: float = 1000.0, *, balanced: bool = False,
) -> Netlist:
    """Write the netlist of module `top` to `folder/top.v`.

    `blocks`: incremented blocks of carry chains by the name of the sum. `budgets`: ps for the other sums by name
    (`map_adders`).
    `boxes`: modules that stay black boxes. Memories of more than `memory_limit` bits are taken out of the logic.
    `balanced`: logic between adders is balanced before it is mapped.
    """
    t, description, constraints, log = technology, folder / f"{top}.json", folder / "abc.constr", folder / "yosys.log"
    run("alumacc", "opt_clean", f"write_json {description}", log=log, design=_elaborate(rtlil, top, boxes, folder))
    constraints.write_text(f"set_driving_cell {t.inverter}\nset_load {t.gate_load_ff} [all_outputs]\n")
    macros, stores = _edit(description, lambda modules: take_out(modules[top], memory_limit))
    chosen = _edit(description, lambda modules: map_adders(modules[top], t, blocks, budgets)) if t.full_adder else {}
    script = ABC_SCRIPT.format(ABC_SHARE * clock_ps, BALANCE if balanced else "").replace(" ", ",")
    run(
        f"read_liberty -lib {liberty}", f"read_json {description}", f"hierarchy -top {top}",
        "opt -full", "memory_map", *_if_memories(rtlil, "attrmap -remove init"), "opt -full", "techmap", "opt -full",
        "simplemap", *_clock_gating(t), f"dfflibmap -liberty {liberty}", "opt",
        f"abc -liberty {liberty} -constr {constraints} -script +{script}", "opt_clean -purge",
        f"write_json {description}", log=log,
    )
    _edit(description, lambda modules: buffer_broadcasts(modules[top], boxes, t.broadcast_buffer))
    if t.drive_ff is not None:
        cells, drive_ff = _pins(liberty), t.drive_ff
        _edit(description, lambda modules: resize(modules[top], cells, drive_ff, t.gate_load_ff))
    verilog, statistics = folder / f"{top}.v", folder / f"{top}.stat"
    run(
        f"read_json {description}", f"hierarchy -top {top}",
        *_constants(t), "splitnets", "opt_clean -purge",
        f"tee -q -o {statistics} stat -top {top} -liberty {liberty} -json",
        f"write_verilog -noattr -noexpr -simple-lhs {verilog}", log=log,
    )
    # OpenSTA does not read `signed`, so it is removed.
    verilog.write_text(re.sub(r"(?m)^(\s*(?:wire|input|output) )signed ", r"\1", verilog.read_text()))
    found = json.loads(statistics.read_text())["modules"][f"\\{top}"]
    cells = {kind: n for kind, n in found["num_cells_by_type"].items() if kind not in boxes}
    return Netlist(verilog, found.get("area", 0.0), cells, Counter(macros), stores, chosen)


def _clock_gating(technology: Technology) -> list[str]:
    """The command that turns enables into clock gates, if the library has one."""
    if technology.clock_gate is None:
        return []
    cell, enable, clock, output, test = technology.clock_gate
    return [f"clockgate -pos {cell} {enable}:{clock}:{output}{f' -tie_lo {test}' if test else ''} -min_net_size 4"]


def _constants(technology: Technology) -> list[str]:
    """The command that turns constants into cells, if the library has such cells."""
    if technology.tie_high is None or technology.tie_low is None:
        return []
    high, low = " ".join(technology.tie_high), " ".join(technology.tie_low)
    return [f"hilomap -singleton -hicell {high} -locell {low}"]


def count_nand2(
    rtlil: str, top: str, folder: Path, boxes: Sequence[str] = (), memory_limit: int = LIMIT,
) -> Netlist:
    """Module `top` in NAND2 equivalents: one for a two-input NAND, half of one for an inverter, NAND2_FLOP for a flip-flop."""
    statistics, verilog, description = (folder / f"{top}-generic.{suffix}" for suffix in ("stat", "v", "json"))
    design, macros, stores = _elaborate(rtlil, top, boxes, folder), [], []
    if "$memrd" in rtlil:
        run(f"write_json {description}", log=folder / "yosys.log", design=design)
        macros, stores = _edit(description, lambda modules: take_out(modules[top], memory_limit))
        design = run(f"read_json {description}", f"hierarchy -top {top}", log=folder / "yosys.log")
    run("alumacc", "opt -full", "memory_map", *_if_memories(rtlil, "attrmap -remove init"), "opt -full", "techmap", "opt -full",
        "dfflegalize -cell $_DFF_P_ x", "techmap",
        "abc -g NAND", "opt_clean -purge", f"tee -q -o {statistics} stat -top {top} -json",
        f"write_verilog -noattr {verilog}", f"write_json {description}", log=folder / "yosys.log", design=design)
    cells = json.loads(statistics.read_text())["modules"][f"\\{top}"]["num_cells_by_type"]
    cells = {kind: n for kind, n in cells.items() if kind not in boxes}
    weights = {"$_NAND_": 1.0, "$_NOT_": 0.5, "$_DFF_P_": NAND2_FLOP}
    unknown = set(cells) - set(weights)
    if unknown:
        raise RuntimeError(f"generic netlist of {top} holds {sorted(unknown)}")
    return Netlist(verilog, sum(weights[kind] * n for kind, n in cells.items()), cells, Counter(macros), stores, {})


@cache
def _pins(liberty: Path) -> dict[str, Pins]:
    """The pins of a library's cells, which every run needs."""
    return pins_of(liberty)


def _edit(path: Path, change: Callable[[dict], Result]) -> Result:
    """Apply `change` to the modules of a netlist in JSON, write them back, and return the result of `change`."""
    netlist = json.loads(path.read_text())
    result = change(netlist["modules"])
    path.write_text(json.dumps(netlist))
    return result
