"""The delay of an inverter that drives four like itself (FO4) in a library: a unit of delay that libraries can be compared by.

    fo4_ps(ASAP7.inverter, liberty, ASAP7.time_unit_ps, Path("build/synth/fo4"))

OpenSTA times a chain of inverters, each with three more as load. What is compared is one stage of the middle of the chain, the
mean of a rising and a falling edge, so that neither the slew at its input nor the load at its end matters.
"""

from __future__ import annotations

import re
from pathlib import Path

from synth.once import run_once
from synth.report import write_text

_STAGES, _LOADS = 12, 3
_FIRST, _LAST = 4, 8
"""Stages of the chain; inverters beside the next one that each drives; and the stages between which the delay is taken."""


def chain(cell: str, inputs: str, output: str) -> str:
    """Verilog of the chain, from `a` to `z`."""
    nets = ["a", *(f"n{k}" for k in range(1, _STAGES)), "z"]
    lines = [f"  {cell} s{k} (.{inputs}({nets[k]}), .{output}({nets[k + 1]}));" for k in range(_STAGES)]
    lines += [f"  {cell} l{k}_{i} (.{inputs}({nets[k + 1]}), .{output}(u{k}_{i}));"
              for k in range(_STAGES - 1) for i in range(_LOADS)]
    wires = ", ".join([*nets[1:-1], *(f"u{k}_{i}" for k in range(_STAGES - 1) for i in range(_LOADS))])
    return "\n".join(["module chain(a, z);", "  input a;", "  output z;", f"  wire {wires};", *lines, "endmodule"]) + "\n"


def pins_of_inverter(liberty: str, cell: str) -> tuple[str, str]:
    """The names of the input and the output of an inverter in the text of a liberty file.

    Raises:
        ValueError: the file has no such cell, or it has other pins.
    """
    found = re.search(rf'\n\s*cell\s*\(\s*"?{re.escape(cell)}"?\s*\)(.*?)(?=\n\s*cell\s*\(|\Z)', liberty, re.DOTALL)
    pins = re.findall(r'\bpin\s*\(\s*"?(\w+)"?\s*\).*?direction\s*:\s*"?(input|output)"?', found[1] if found else "", re.DOTALL)
    ways = {way: name for name, way in pins}
    if sorted(way for _, way in pins) != ["input", "output"]:
        raise ValueError(f"{cell} must be an inverter of the library, with an input and an output, not {pins!r}")
    return ways["input"], ways["output"]


def fo4_ps(cell: str, liberty: Path, time_unit_ps: float, folder: Path) -> float:
    """The delay in ps. What OpenSTA reads and says stays in `folder`.

    Raises:
        RuntimeError: OpenSTA failed or found no path.
        ValueError: the library has no such inverter.
    """
    folder.mkdir(parents=True, exist_ok=True)
    verilog = folder / "chain.v"
    write_text(verilog, chain(cell, *pins_of_inverter(liberty.read_text(), cell)))
    commands = "\n".join([
        f"read_liberty {liberty}", f"read_verilog {verilog}", "link_design chain", "create_clock -name c -period 1000",
        "set_input_delay 0 -clock c [get_ports a]", "set_output_delay 0 -clock c [get_ports z]",
        *(f"report_checks -{edge}_from [get_ports a] -to [get_ports z] -digits 5" for edge in ("rise", "fall"))]) + "\n"
    output = run_once(commands, [liberty, verilog], folder, "chain")
    delays = []
    for report in output.split("Startpoint")[1:]:
        at = {int(stage): float(time) for time, stage in re.findall(r"(?m)^\s*[\d.]+\s+([\d.]+)\s+[v^] s(\d+)/", report)}
        if {_FIRST, _LAST} <= at.keys():
            delays.append((at[_LAST] - at[_FIRST]) / (_LAST - _FIRST) * time_unit_ps)
    if not delays:
        raise RuntimeError(f"sta reported no path through the chain:\n{output}")
    return sum(delays) / len(delays)
