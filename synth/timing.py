"""Static timing analysis of a netlist with OpenSTA (Debian's package `opensta`, command `sta`)."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from synth.liberty import Technology

CLOCK_TRANSITION = 0.02
"""Transition time of the clock, as a share of its period."""

INPUT_DELAY = 0.1
"""Arrival time of inputs as a share of the clock; they come from registers outside the unit over the wires of a row."""

OUTPUT_DELAY = 0.05
"""Time before the clock edge at which outputs must be stable, as a share of the clock; they feed registers outside."""

MEMORY_READ = 0.3
"""Time after the clock edge at which a memory's data arrive, as a share of the clock."""

MEMORY_SETUP = 0.1
"""Setup time of a memory's address, data and enables, as a share of the clock."""

_LATE_PATHS = 2000

WIRE_DERATE = 1.15
"""Assumed ratio of delays with wires to those without: what the placed units need, all but a row, whose long nets a layout
would repair (reports/wires.json). Clocks are reported with and without it."""


@dataclass(frozen=True)
class Timing:
    """The result of a timing run; times in ps."""

    clock_ps: float
    slack_ps: float
    path: str
    version: str
    late_sums: frozenset[str] = frozenset()
    """Names of the sums whose full adders are on paths with negative slack."""

    @property
    def zero_slack_ps(self) -> float:
        """The shortest clock period that has no negative slack."""
        return self.clock_ps - self.slack_ps


def available() -> bool:
    """Whether the command `sta` is installed."""
    return shutil.which("sta") is not None


def run_sta(commands: str, folder: Path, name: str = "sta") -> str:
    """The output of OpenSTA for a script, which stays in `folder` so that it can be run again by hand."""
    script = folder / f"{name}.tcl"
    script.write_text(commands)
    done = subprocess.run(["sta", "-no_splash", "-no_init", "-exit", str(script)], capture_output=True, text=True, check=False)
    if done.returncode or "Error:" in done.stdout + done.stderr:
        raise RuntimeError(f"sta failed on {script}:\n{done.stdout}{done.stderr}")
    return done.stdout


def preamble(
    verilog: list[Path], top: str, clock_ps: float, technology: Technology, liberty: Path, memories: bool = False,
) -> str:
    """Commands that read a netlist and constrain it. `memories`: some of its ports are pins of memories."""
    clock = clock_ps / technology.time_unit_ps
    return "\n".join([
        f"read_liberty {liberty}", *(f"read_verilog {path}" for path in verilog), f"link_design {top}",
        f"create_clock -name clk -period {clock} [get_ports clk]",
        f"set_clock_transition {CLOCK_TRANSITION * clock} [get_clocks clk]",
        "set inputs [list]",
        "foreach p [all_inputs] { if {[get_property $p full_name] != \"clk\"} { lappend inputs $p } }",
        f"set_input_delay {INPUT_DELAY * clock} -clock clk $inputs",
        "set_driving_cell -lib_cell {} -pin {} $inputs".format(*technology.driver),
        f"set_output_delay {OUTPUT_DELAY * clock} -clock clk [all_outputs]",
        f"set_load {technology.load} [all_outputs]",
        # It is held for many cycles, and like the clock it would be distributed by a tree
        "set_false_path -from [get_ports rst]",
        *(f"foreach p [all_{way}puts] {{ if {{[string match memory* [get_property $p full_name]]}} "
          f"{{ set_{way}put_delay {share * clock} -clock clk $p }} }}"
          for way, share in (("in", MEMORY_READ), ("out", MEMORY_SETUP)) if memories),
    ]) + "\n"


def analyse(
    verilog: list[Path], top: str, clock_ps: float, technology: Technology, liberty: Path, folder: Path, memories: bool = False,
) -> Timing:
    """Worst setup slack of module `top`; infinite if nothing is clocked. `memories`: memories were taken out of the module."""
    commands = preamble(verilog, top, clock_ps, technology, liberty, memories)
    digits = 1 if technology.time_unit_ps <= 1 else 4
    commands += f"report_checks -path_delay max -fields {{capacitance slew fanout}} -digits {digits}\n"
    commands += f"report_worst_slack -digits {digits + 1}\n"
    commands += f"puts LATE\nreport_checks -path_delay max -slack_max 0 -group_count {_LATE_PATHS} -digits {digits}\n"
    output, late = run_sta(commands, folder).split("LATE\n")
    slack = re.findall(r"worst slack\s+(-?[\d.]+)", output)
    if not slack:
        raise RuntimeError(f"sta reported no slack:\n{output}")
    version = subprocess.run(["sta", "-version"], capture_output=True, text=True, check=False).stdout.strip()
    late_sums = frozenset(re.findall(r" ([\w.]+)_fa\d+/", late))
    return Timing(clock_ps, round(float(slack[-1]) * technology.time_unit_ps, 2), output, version, late_sums)
