"""Timing of the memories that were taken out of a module (`synth.memories`), as a liberty cell each.

A memory is built of macros (`synth.macros`), whose access and setup times are read from their liberty files. To these are added
the multiplexers behind macros on top of each other or folded, and the buffers from an address to many macros: a macro's pin has
5 fF, and forty of them are more than a gate drives. The macros' files have the typical corner only; a factor stands for others.
Memories that are smaller as flip-flops have the same cell, with the flip-flop's times and multiplexers for all words.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from math import ceil, log
from pathlib import Path

from synth.liberty import PDK_VARIABLE
from synth.macros import FOLDER, make
from synth.memories import Macro

ACCESS_PS, SETUP_PS, HOLD_PS, PIN_FF = 218.0, 50.0, 50.0, 5.0
"""Times and input capacitance of fakeram7's macros of all sizes, used where the liberty files are missing."""

FLOP_ACCESS_PS, FLOP_SETUP_PS = 41.0, 15.0
"""The same of ASAP7's DFFHQNx1, for memories that are flip-flops."""

MUX_PS = 27.0
"""Delay of a 2:1 multiplexer (AO22x1 into the next one, ASAP7 typical, found with OpenSTA)."""

BUFFER_PS, MACROS_PER_BUFFER = 37.0, 4
"""Delay of a buffer (BUFx5 into four macros' pins of 5 fF, found in the same way), and the number of macros that it drives."""

MOST_FF = 500.0
"""Largest load of a macro's output."""

PINS = ("rd_addr", "rd_en", "wr_addr", "wr_en", "wr_data", "rd_data")
"""Pins that `synth.memories.take_out` makes into ports; all but the last are inputs of the memory."""


@dataclass(frozen=True)
class MemoryTiming:
    """Times of a memory in ps at the typical corner, and how they were found."""

    access_ps: float
    setup_ps: float
    hold_ps: float
    pin_ff: float
    source: str


@cache
def _macro(path: Path) -> tuple[float, float, float, float]:
    """Access, setup, hold (ps) and input capacitance (fF) of a macro, from its liberty file if it is there."""
    return macro_times(path.read_text()) if path.is_file() else (ACCESS_PS, SETUP_PS, HOLD_PS, PIN_FF)


def macro_times(text: str) -> tuple[float, float, float, float]:
    """The largest access, setup and hold time in ps and input capacitance in fF in a macro's liberty text (ns and pF).

    Raises:
        ValueError: one of them is not in it.
    """
    found: dict[str, list[float]] = {"rising_edge": [], "setup_rising": [], "hold_rising": []}
    for arc in re.split(r"\btiming\s*\(\s*\)", text)[1:]:
        kind = re.search(r"timing_type\s*:\s*(\w+)", arc)
        tables = r"(?:cell_\w+|\w+_constraint)\s*\([^)]*\)\s*\{[^}]*?values\s*\(([^)]*)\)"
        if kind and kind[1] in found:
            found[kind[1]] += [float(number) for table in re.findall(tables, arc) for number in re.findall(r"[\d.]+", table)]
    pins = [float(value) for name, value in re.findall(
        r"(?:pin|bus)\s*\((\w+)\)\s*\{[^{}]*?\scapacitance\s*:\s*([\d.]+)", text) if name != "clk"]
    if not all(found.values()) or not pins:
        raise ValueError("the liberty text must have access, setup and hold times and capacitances of pins")
    access, setup, hold = (1e3 * max(values) for values in found.values())
    return access, setup, hold, 1e3 * max(pins)


def memory_timing(memory: Macro) -> MemoryTiming:
    """The times of a memory as `synth.macros.make` builds it."""
    made = make(memory)
    if made.kind == "flip-flops":
        levels = _levels(memory.words)
        return MemoryTiming(FLOP_ACCESS_PS, FLOP_SETUP_PS + levels * MUX_PS, 0.0, PIN_FF,
                            f"flip-flops, their address through {levels} multiplexers of {MUX_PS:.0f} ps")
    folder = Path(os.environ.get(PDK_VARIABLE, "/nowhere")) / FOLDER
    times = [_macro(folder / f"{name}.lib") for name in made.macros]
    copies = memory.reads if memory.writes == 1 else 1
    count = sum(made.macros.values()) // copies
    bits = sum(number * int(name.rpartition("x")[2]) for name, number in made.macros.items()) // copies
    levels, buffers = _levels(bits // memory.width), ceil(log(count, MACROS_PER_BUFFER) - 1e-9) if count > 1 else 0
    access, setup, hold, pin = (max(column) for column in zip(*times, strict=True))
    return MemoryTiming(
        access + levels * MUX_PS, setup + buffers * BUFFER_PS, hold, pin,
        f"{count} macros: {access:.0f} ps and {levels} multiplexers, setup {setup:.0f} ps and {buffers} buffers")


def _levels(ways: int) -> int:
    return max(0, ways - 1).bit_length()


@dataclass(frozen=True)
class MemoryCell:
    """A memory as a cell: its name, the width of each of its pins, and its times."""

    name: str
    pins: Mapping[str, int]
    timing: MemoryTiming


def liberty(cells: Sequence[MemoryCell], factor: float) -> str:
    """A liberty library of memory cells, in ps and fF, with all times multiplied by `factor`.

    The transition at a data pin is that of the macros' files: 9 ps at 5 fF, and 227 ps at 500 fF.
    """
    widths = sorted({width for cell in cells for width in cell.pins.values() if width > 1})
    types = "".join(f"  type (bits{width}) {{ base_type : array; data_type : bit; bit_width : {width}; bit_from : {width - 1}; "
                    "bit_to : 0; downto : true; }\n" for width in widths)
    return (
        "library (msv2_memories) {\n  delay_model : table_lookup;\n  time_unit : \"1ps\";\n  capacitive_load_unit (1,ff);\n"
        "  voltage_unit : \"1V\";\n  current_unit : \"1mA\";\n  pulling_resistance_unit : \"1kohm\";\n"
        "  leakage_power_unit : \"1pW\";\n  input_threshold_pct_fall : 50;\n  input_threshold_pct_rise : 50;\n"
        "  output_threshold_pct_fall : 50;\n  output_threshold_pct_rise : 50;\n  slew_lower_threshold_pct_fall : 10;\n"
        "  slew_lower_threshold_pct_rise : 10;\n  slew_upper_threshold_pct_fall : 90;\n  slew_upper_threshold_pct_rise : 90;\n"
        "  nom_process : 1;\n  nom_temperature : 25;\n  nom_voltage : 0.7;\n"
        "  lu_table_template (by_load) { variable_1 : total_output_net_capacitance; index_1 (\"5, 500\"); }\n"
        f"{types}{''.join(_cell(cell, factor) for cell in cells)}}}\n")


def _cell(cell: MemoryCell, factor: float) -> str:
    body = "".join(_pin(pin, width, cell.timing, factor) for pin, width in cell.pins.items())
    return (f"  cell ({cell.name}) {{\n    area : 0;\n    interface_timing : true;\n"
            f"    pin (clk) {{ direction : input; clock : true; capacitance : 1; }}\n{body}  }}\n")


def _pin(pin: str, width: int, timing: MemoryTiming, factor: float) -> str:
    head = f"    bus ({pin}) {{ bus_type : bits{width};" if width > 1 else f"    pin ({pin}) {{"
    if pin == "rd_data":
        edges = "".join(f" cell_{edge} (scalar) {{ values (\"{factor * timing.access_ps:.1f}\"); }}"
                        f" {edge}_transition (by_load) {{ values (\"9, 227\"); }}" for edge in ("rise", "fall"))
        return (f"{head} direction : output; max_capacitance : {MOST_FF:.0f}; "
                f"timing () {{ related_pin : \"clk\"; timing_type : rising_edge;{edges} }} }}\n")
    checks = "".join(
        f" timing () {{ related_pin : \"clk\"; timing_type : {kind}_rising;"
        f" rise_constraint (scalar) {{ values (\"{time:.1f}\"); }} fall_constraint (scalar) {{ values (\"{time:.1f}\"); }} }}"
        for kind, time in (("setup", factor * timing.setup_ps), ("hold", factor * timing.hold_ps)))
    return f"{head} direction : input; capacitance : {timing.pin_ff:.2f};{checks} }}\n"

