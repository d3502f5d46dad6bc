"""A machine of five modules as the flow would map them, in a library of three cells with round delays.

    controller (register, 3 buffers) > inverter of the top > counters (2 buffers, register)
                                                           > geometry (inverter) > reader (4 buffers, register)
    reader, geometry, top: a way without a register from `start` to `found` and on to counters
    reader: a memory whose data go to `found`, too

A buffer and an inverter take 10 ps, a register 40 ps from its clock and 20 ps of setup; nothing depends on loads.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

from synth.corners import Corner
from synth.design import Design
from synth.interfaces import ports_of
from synth.liberty import ASAP7
from synth.machine import TOP

_GATE = """  cell ({0}) {{ area : 1; pin (A) {{ direction : input; capacitance : 1; }}
    pin (Y) {{ direction : output; function : "{1}"; max_capacitance : 100; timing () {{ related_pin : "A"; timing_sense : {2};
      cell_rise (scalar) {{ values ("10"); }} cell_fall (scalar) {{ values ("10"); }}
      rise_transition (scalar) {{ values ("5"); }} fall_transition (scalar) {{ values ("5"); }} }} }} }}
"""

_CHECK = """timing () {{ related_pin : "CLK"; timing_type : {0}_rising;
      rise_constraint (scalar) {{ values ("{1}"); }} fall_constraint (scalar) {{ values ("{1}"); }} }}"""

LIBERTY = f"""library (small) {{ delay_model : table_lookup; time_unit : "1ps"; capacitive_load_unit (1,ff);
  voltage_unit : "1V"; current_unit : "1mA"; pulling_resistance_unit : "1kohm"; leakage_power_unit : "1pW";
  nom_process : 1; nom_temperature : 25; nom_voltage : 0.7; default_max_transition : 320;
  input_threshold_pct_fall : 50; input_threshold_pct_rise : 50; output_threshold_pct_fall : 50; output_threshold_pct_rise : 50;
  slew_lower_threshold_pct_fall : 10; slew_lower_threshold_pct_rise : 10; slew_upper_threshold_pct_fall : 90;
  slew_upper_threshold_pct_rise : 90;
{_GATE.format("BUF", "A", "positive_unate")}{_GATE.format("INV", "!A", "negative_unate")}
  cell (DFF) {{ area : 3; ff (IQ, IQN) {{ clocked_on : "CLK"; next_state : "D"; }}
    pin (CLK) {{ direction : input; clock : true; capacitance : 1; }}
    pin (D) {{ direction : input; capacitance : 1; {_CHECK.format("setup", 20)} {_CHECK.format("hold", 5)} }}
    pin (Q) {{ direction : output; function : "IQ"; max_capacitance : 100;
      timing () {{ related_pin : "CLK"; timing_type : rising_edge; cell_rise (scalar) {{ values ("40"); }}
        cell_fall (scalar) {{ values ("40"); }} rise_transition (scalar) {{ values ("5"); }}
        fall_transition (scalar) {{ values ("5"); }} }} }} }}
}}
"""

CLOCK_PS = 100.0


def _module(name: str, ports: str, *cells: tuple[str, str, str]) -> str:
    """A module; `ports` has `>name` for inputs and `<name` for outputs, a cell its kind, its name and its pins."""
    declared = [("input" if port[0] == ">" else "output", port[1:]) for port in ports.split()]
    head = f"module {name}({', '.join(port for _, port in declared)});\n"
    body = "".join(f"  {way} {port};\n  wire {port};\n" for way, port in declared)
    for kind, label, pins in cells:
        named = ",\n".join("    .{}({})".format(*pin.split("=")) for pin in pins.split())
        body += f"  {kind} {label} (\n{named}\n  );\n"
    return f"{head}{body}endmodule\n"


def _chain(first: str, last: str, length: int) -> list[tuple[str, str, str]]:
    nets = [first, *(f"{last}_{k}" for k in range(1, length)), last]
    return [("BUF", f"_{last}{k}_", f"A={nets[k]} Y={nets[k + 1]}") for k in range(length)]


def netlists() -> dict[str, str]:
    """The netlists by module, lower ones first; the reader's memory is still ports."""
    reader = _module(
        f"{TOP}__geometry__reader", ">clk >rst >start <found", *_chain("start", "late", 4),
        ("DFF", "_1_", "CLK=clk D=late Q=q"), ("INV", "_2_", "A=start Y=found"))
    memory = ("  output [2:0] memory0_rd_addr;\n  wire [2:0] memory0_rd_addr;\n  input [7:0] memory0_rd_data;\n"
              "  wire [7:0] memory0_rd_data;\n  DFF _3_ (\n    .CLK(clk),\n    .D(memory0_rd_data[5]),\n    .Q(p)\n  );\n"
              "  assign memory0_rd_addr = { q, p, q };\n")
    reader = reader.replace("found);\n", "found, memory0_rd_addr\n, memory0_rd_data);\n", 1)
    reader = reader.replace("endmodule", f"{memory}endmodule")
    return {
        f"{TOP}__controller": _module(
            f"{TOP}__controller", ">clk >rst >go <count", ("DFF", "_1_", "CLK=clk D=go Q=q"), *_chain("q", "count", 3)),
        f"{TOP}__counters": _module(
            f"{TOP}__counters", ">clk >rst >count >found <done", *_chain("count", "late", 2),
            ("DFF", "_1_", "CLK=clk D=late Q=done"), ("DFF", "_2_", "CLK=clk D=found Q=other")),
        f"{TOP}__geometry__reader": reader,
        f"{TOP}__geometry": _module(
            f"{TOP}__geometry", ">clk >rst >start <found", ("INV", "_1_", "A=start Y=go"),
            (f"{TOP}__geometry__reader", "reader", "clk=clk rst=rst start=go found=found")),
        TOP: _module(
            TOP, ">clk >rst >go <done", ("INV", "_1_", "A=count Y=counted"),
            (f"{TOP}__controller", "controller", "clk=clk rst=rst go=go count=count"),
            ("BUF", "_2_", "A=rst Y=units_rst"),
            (f"{TOP}__geometry", "geometry", "clk=clk rst=units_rst start=counted found=found"),
            (f"{TOP}__counters", "counters", "clk=clk rst=rst count=counted found=found done=done")),
    }


STORES = [{"name": "table", "words": 4, "width": 3, "reads": 1, "writes": 0, "made_as": "logic: never written"},
          {"name": "store", "words": 8, "width": 8, "reads": 1, "writes": 0, "made_as": "macro"}]
"""The reader's memories: the second was taken out."""


def small_machine(folder: Path) -> tuple[Design, dict[str, dict], Corner]:
    """The design, the `module_result` of each module, and the corner with the small library, all written to `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    texts, parts = {}, {}
    for name, text in netlists().items():
        path = folder / f"{name}.v"
        path.write_text(text)
        stores = STORES if name.endswith("reader") else []
        parts[name] = {"netlist": str(path), "stores": stores, "memories": stores[1:], "cells_by_type": {"BUF": 1}}
        ports = [f"  wire width {width} {way} {place} \\{port}\n"
                 for place, (port, (way, width)) in enumerate(ports_of(text).items()) if not port.startswith("memory")]
        texts[name] = f"module \\{name}\n{''.join(ports)}end\n"
    below = {name: Counter() for name in texts}
    below[f"{TOP}__geometry"][f"{TOP}__geometry__reader"] = 1
    below[TOP].update([f"{TOP}__controller", f"{TOP}__geometry", f"{TOP}__counters"])
    library = folder / "small.lib"
    library.write_text(LIBERTY)
    technology = replace(ASAP7, name="small", files=(str(library.resolve()),), driver=("DFF", "Q"), load=1.0)
    return Design(TOP, texts, below), parts, Corner("small", technology)
