"""The flow: one component to a netlist of library cells, module by module, and its area."""

from __future__ import annotations

import json
from pathlib import Path

from pyosys import libyosys

from synth.adders import Counts, map_adders
from synth.liberty import Technology

AREA_SCRIPT = "strash; dch; map -B 0.9 -D 100000 -a; topo; dnsize; buffer -c -N 24; upsize -D 100000; dnsize -D 100000"


def yosys(design: libyosys.Design, *commands: str) -> None:
    for command in commands:
        libyosys.run_pass(command, design)


def synthesise(rtlil: str, top: str, technology: Technology, liberty: Path, folder: Path) -> Counts:
    """Write `folder/top.v` and `folder/top.json`: the netlist of module `top`. Returns what was built of full adders."""
    folder.mkdir(parents=True, exist_ok=True)
    source, netlist = folder / f"{top}.il", folder / f"{top}.json"
    source.write_text(rtlil)
    design = libyosys.Design()
    yosys(design, f"read_rtlil {source}", f"hierarchy -top {top}", "proc", "flatten", "opt", "alumacc", "opt_clean",
          f"write_json {netlist}")
    description = json.loads(netlist.read_text())
    counts = map_adders(description["modules"][top], technology.full_adder)
    netlist.write_text(json.dumps(description))

    design = libyosys.Design()
    t = technology
    yosys(
        design, f"read_liberty -lib {liberty}", f"read_json {netlist}", f"hierarchy -top {top}",
        "opt -full", "memory_map", "opt -full", "techmap", "opt -full",
        f"clockgate -pos {t.clock_gate} ENA:CLK:GCLK -tie_lo SE -min_net_size 4",
        f"dfflibmap -liberty {liberty}", "opt", f"abc -liberty {liberty} -script +{AREA_SCRIPT.replace(' ', ',')}",
        f"hilomap -singleton -hicell {t.tie_high} H -locell {t.tie_low} L", "splitnets", "opt_clean -purge",
        f"tee -q -o {folder}/{top}.stat stat -liberty {liberty} -json", f"write_verilog -noattr -noexpr {folder}/{top}.v",
    )
    return counts
