"""The whole machine in one run of OpenSTA: all mapped modules are linked, with memories as cells of their own.

    timing = time_machine(design, parts, TYPICAL, folder)
    timing.slack_ps, timing.pairs[0]

Every instance of a module is timed with its own neighbours; the netlist of equal modules is read once. Nothing is a black box.
Clocks are ideal and there are no wires. What the units' own runs assume at their ports (`synth.timing`) holds here only for the
ports of the machine.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from spec.errors import InputError
from synth import timing
from synth.corners import HOLD_UNCERTAINTY_PS, INPUT_SLEW_PS, SLEW_LIMIT_PS, UNCERTAINTY, Corner
from synth.design import Design
from synth.hold import MemoryPort, buffers
from synth.machine import TOP, UNIT_GROUPS, label
from synth.macro_timing import PINS, MemoryCell, liberty, memory_timing
from synth.memories import MADE_AS, Macro
from synth.once import run_once
from synth.report import write_text

INSTALL = "OpenSTA is not installed: on Debian and Ubuntu, `apt-get install opensta` brings the command `sta`"

RESET_NET = "units_rst"
"""The net in the machine's own module that resets the units, from the port `rst` or by the controller. It is held for several
cycles while they are quiet, and a tree would distribute it: here the units get the ideal reset of the port."""

_MEMORY_PORT = re.compile(rf"memory(\d+)_({'|'.join(PINS)})")
_MEMORY_PIN = re.compile(r"(?:^|/)(memory\d+)/(\w+)")
_MOST_PATHS = 1_000_000


@dataclass(frozen=True)
class Pair:
    """The late endpoints of one pair of units.

    Attributes:
        start, end: the unit in which the paths begin, and the one in which they end. "ports" stands for ports of the machine.
        through: the units that the latest of these paths crosses, in order, with both ends.
        endpoints: number of late endpoints.
        slack_ps: the worst slack.
        start_pin, end_pin: the ends of the latest path.
    """

    start: str
    end: str
    through: tuple[str, ...]
    endpoints: int
    slack_ps: float
    start_pin: str
    end_pin: str


@dataclass(frozen=True)
class LinkedTiming:
    """The timing of a machine at one corner.

    Attributes:
        corner, clock_ps, uncertainty: how it was timed; the uncertainty as a share of the clock.
        slack_ps: worst setup slack.
        late_endpoints: endpoints with negative setup slack.
        pairs: these endpoints by pair of units, the latest first.
        total_negative_ps: sum of the negative slacks.
        hold_slack_ps, hold_endpoints, hold_at_memories: worst hold slack, endpoints that miss it, and how many of them are pins
            of memories.
        slew_nets: nets whose transition is slower than the limit, without clocks and the reset.
        slew_slack_ps: the worst of them, relative to the limit; null if there are none.
        slew_clocks: clock gates whose registers are too many for them without a tree.
        path: the report of the worst path.
        early: the ports to memories that miss hold.
    """

    corner: str
    clock_ps: float
    uncertainty: float
    slack_ps: float
    late_endpoints: int
    pairs: tuple[Pair, ...]
    total_negative_ps: float
    hold_slack_ps: float
    hold_endpoints: int
    hold_at_memories: int
    slew_nets: int
    slew_slack_ps: float | None
    slew_clocks: int
    path: str
    early: tuple[MemoryPort, ...] = ()

    @property
    def zero_slack_ps(self) -> float:
        """The shortest clock without negative slack; uncertainty is a share of it."""
        return zero_slack_ps(self.clock_ps, self.slack_ps, self.uncertainty)

    @property
    def ghz(self) -> float:
        """The clock at zero slack."""
        return 1e3 / self.zero_slack_ps


def zero_slack_ps(clock_ps: float, slack_ps: float, uncertainty: float) -> float:
    """The clock at which the worst path has no slack, where uncertainty is a share of the clock and delays do not change."""
    return (clock_ps * (1 - uncertainty) - slack_ps) / (1 - uncertainty)


def check() -> None:
    """Raises InputError, which says how to install it, if OpenSTA is absent."""
    if not timing.available():
        raise InputError(INSTALL)


def memory_cells(stores: Iterable[Mapping[str, object]], text: str) -> dict[str, MemoryCell]:
    """The memories that were taken out of a module, as cells, by the beginning of their ports' names (`memory3`).

    `stores`: all memories of the module, in order, as in a `module_result`. `text`: the module's netlist.
    """
    taken = [Macro(*(store[key] for key in ("words", "width", "reads", "writes"))) for store in stores
             if store["made_as"] == MADE_AS[0]]
    found: dict[str, MemoryCell] = {}
    declared = re.findall(rf"(?m)^  (?:input|output) (?:\[(\d+):0\] )?{_MEMORY_PORT.pattern} ?;$", text)
    for k, memory in enumerate(taken):
        pins = {pin: int(high or 0) + 1 for high, number, pin in declared if int(number) == k}
        shape = "_".join(f"{pin}{width}" for pin, width in pins.items())
        name = f"memory_{memory.words}x{memory.width}_{memory.reads}r{memory.writes}w_{shape}"
        found[f"memory{k}"] = MemoryCell(name, pins, memory_timing(memory))
    return found


def with_memories(
    text: str, cells: Mapping[str, MemoryCell], held: Mapping[str, int] | None = None,
    buffer: tuple[str, str, str] = ("", "", ""),
) -> str:
    """The netlist of a module with its memories in it instead of ports to them.

    `held`: how many buffers in a row stand before each bit of a port (`synth.hold`). `buffer`: the cell, and its pins.
    """
    if not cells:
        return text
    begin, end = text.index("module "), text.index(");")
    head, body = text[begin:end], text[end:]
    name, _, ports = head.partition("(")
    kept = [port for port in map(str.strip, re.split(r",", ports)) if not _memory_port(port, cells)]
    declared = re.compile(r"  (?:input|output) (?:\[\d+:0\] )?(\S+?) ?;$")
    lines = [line for line in body.splitlines(keepends=True)
             if not ((found := declared.match(line)) and _memory_port(found[1], cells))]
    instances = ""
    for memory, cell in cells.items():
        nets, before = "", ""
        for pin, width in cell.pins.items():
            net, added = buffers(f"{memory}_{pin}", width, (held or {}).get(f"{memory}_{pin}", 0), buffer)
            nets, before = f"{nets},\n    .{pin}({net})", before + added
        instances += f"{before}  {cell.name} {memory} (\n    .clk(clk){nets}\n  );\n"
    joined = "".join(lines)
    last = joined.rindex("endmodule")
    # An escaped name ends with a space
    listed = ", ".join(f"{port} " if port.startswith("\\") else port for port in kept)
    return f"{text[:begin]}{name}({listed}{joined[:last]}{instances}{joined[last:]}"


def _memory_port(port: str, cells: Mapping[str, MemoryCell]) -> bool:
    found = _MEMORY_PORT.fullmatch(port)
    return found is not None and f"memory{found[1]}" in cells


class Hierarchy:
    """Which unit an instance belongs to, by its path below the machine."""

    def __init__(self, top: str, texts: Mapping[str, str]) -> None:
        """`texts`: the netlist of each module, by name."""
        self.top, self.units = top, {label(unit): unit or TOP for unit in UNIT_GROUPS}
        kinds = "|".join(sorted(map(re.escape, texts), key=len, reverse=True))
        self.inside = {
            name: {instance.strip().lstrip("\\"): kind for kind, instance in re.findall(
                rf"(?m)^  ({kinds}) (\\?\S+) *\($", text)} for name, text in texts.items()}

    def module(self, path: str) -> str:
        """The innermost module that holds the instance or pin at this path."""
        module = self.top
        for part in path.split("/"):
            module = self.inside.get(module, {}).get(part.lstrip("\\"), module)
        return module

    def unit(self, path: str) -> str:
        """The innermost unit that holds the instance or pin at this path; the machine's own name if it is in no other."""
        module, found = self.top, self.units.get(self.top, self.top)
        for part in path.split("/"):
            module = self.inside.get(module, {}).get(part.lstrip("\\"), "")
            found = self.units.get(module, found)
        return found


def constraints(corner: Corner, clock_ps: float, uncertainty: float) -> str:
    """Commands that constrain the linked machine."""
    clock, cell = clock_ps / corner.technology.time_unit_ps, corner.technology.driver
    slew = INPUT_SLEW_PS / corner.technology.time_unit_ps
    return "\n".join([
        f"create_clock -name clk -period {clock} [get_ports clk]",
        f"set_clock_transition {timing.CLOCK_TRANSITION * clock} [get_clocks clk]",
        f"set_clock_uncertainty -setup {uncertainty * clock} [get_clocks clk]",
        f"set_clock_uncertainty -hold {HOLD_UNCERTAINTY_PS / corner.technology.time_unit_ps} [get_clocks clk]",
        "set inputs [list]",
        "foreach p [all_inputs] { if {[lsearch {clk rst} [get_property $p full_name]] < 0} { lappend inputs $p } }",
        f"set_input_delay {timing.INPUT_DELAY * clock} -clock clk $inputs",
        f"set_driving_cell -lib_cell {cell[0]} -pin {cell[1]} -input_transition_rise {slew} "
        f"-input_transition_fall {slew} $inputs",
        f"set_output_delay {timing.OUTPUT_DELAY * clock} -clock clk [all_outputs]",
        f"set_load {corner.technology.load} [all_outputs]",
        f"set_max_transition {SLEW_LIMIT_PS / corner.technology.time_unit_ps} [current_design]",
        "set_false_path -from [get_ports rst]",
        f"set_input_transition {slew} [get_ports rst]",
    ]) + "\n"


PATHS = """\
proc report_paths {kind} {
  foreach path [find_timing_paths -path_delay $kind -slack_max 0 -group_count MOST] {
    set units {}
    set last ""
    if {$kind == "max"} {
      foreach point [get_property $path points] {
        set place [get_property [get_property $point pin] full_name]
        regsub {/?[^/]+/[^/]+$} $place {} place
        if {$place != $last} { lappend units $place; set last $place }
      }
    }
    set ends {}
    foreach end {startpoint endpoint} { lappend ends [get_property [get_property $path $end] full_name] }
    puts "[get_property $path slack]\\t[join $ends \\t]\\t[join $units { }]"
  }
}
""".replace("MOST", str(_MOST_PATHS))


@dataclass(frozen=True)
class Written:
    """What OpenSTA reads: netlists with memories as cells, lower ones first, and these cells with their library."""

    netlists: tuple[Path, ...]
    cells: tuple[MemoryCell, ...]
    library: Path
    hierarchy: Hierarchy


def write_machine(
    design: Design, parts: Mapping[str, dict], corner: Corner, folder: Path, held: Mapping[MemoryPort, int] | None = None,
) -> Written:
    """Write to `folder` what OpenSTA reads of a machine. `held`: buffers in a row before ports to memories (`synth.hold`)."""
    folder.mkdir(parents=True, exist_ok=True)
    paths, texts, cells = [], {}, {}
    for name in design.texts:
        text = Path(parts[name]["netlist"]).read_text()
        memories = memory_cells(parts[name]["stores"], text)
        cells |= {cell.name: cell for cell in memories.values()}
        inside = {port: count for (module, port), count in (held or {}).items() if module == name}
        whole = with_memories(text, memories, inside, corner.technology.broadcast_buffer)
        texts[name] = whole.replace(f".rst({RESET_NET})", ".rst(rst)")
        path = Path(parts[name]["netlist"])
        if texts[name] != text:
            path = folder / f"{name}.v"
            write_text(path, texts[name])
        paths.append(path)
    library = folder / f"memories-{corner.name}.lib"
    write_text(library, liberty(list(cells.values()), corner.memory_factor))
    return Written(tuple(paths), tuple(cells.values()), library, Hierarchy(design.top, texts))


def time_machine(
    design: Design, parts: Mapping[str, dict], corner: Corner, folder: Path, clock_ps: float = 1000.0,
    uncertainty: float = UNCERTAINTY, held: Mapping[MemoryPort, int] | None = None,
) -> LinkedTiming:
    """The timing of the linked machine; scripts, paths and reports stay in `folder`.

    `parts`: the `module_result` of each module of the design. `held`: buffers in a row before ports to memories.

    Raises:
        InputError: OpenSTA or liberty files are missing.
    """
    check()
    written = write_machine(design, parts, corner, folder, held)
    library = corner.liberty(folder.parent)
    commands = "\n".join([
        f"read_liberty {library}", f"read_liberty {written.library}",
        *(f"read_verilog {path}" for path in written.netlists), f"link_design {design.top}",
    ]) + "\n" + constraints(corner, clock_ps, uncertainty) + PATHS + (
        "report_worst_slack -digits 3\nreport_tns -digits 1\n"
        "report_checks -path_delay max -fields {capacitance slew} -digits 1\n"
        "puts HOLD\nreport_checks -path_delay min -format end -digits 3\nputs LATE\nreport_paths max\nputs EARLY\n"
        "report_paths min\nputs SLEWS\nreport_check_types -max_transition -all_violators -format end -digits 1\n")
    output = run_once(commands, [library, written.library, *written.netlists], folder, f"machine-{corner.name}")
    return read_timing(output, written, corner, clock_ps, uncertainty)


def read_timing(output: str, written: Written, corner: Corner, clock_ps: float, uncertainty: float) -> LinkedTiming:
    """The results in what OpenSTA wrote.

    Raises:
        RuntimeError: it reported no slack.
    """
    unit_ps = corner.technology.time_unit_ps
    slack = re.findall(r"worst slack\s+(-?[\d.]+)", output)
    if not slack:
        raise RuntimeError(f"sta reported no slack:\n{output}")
    report, hold, late, early, slews = re.split(r"(?m)^(?:HOLD|LATE|EARLY|SLEWS)\n", output)
    ends = [line for line in _paths(early) if float(line.split("\t")[0]) < 0]
    holds = [float(value) for value in re.findall(r"(-?[\d.]+) \((?:MET|VIOLATED)\)", hold)]
    negative = [float(line.split("\t")[0]) * unit_ps for line in _paths(late)]
    bad = {pin: float(value) * unit_ps for pin, value in re.findall(r"(?m)^(\S+) .*?(-[\d.]+) \(VIOLATED\)", slews)}
    technology = corner.technology
    drivers = {"Y", technology.driver[1], *(technology.full_adder[1][3:] if technology.full_adder else ())}
    nets = {pin: value for pin, value in bad.items() if pin.rpartition("/")[2] in drivers or "/rd_data" in pin}
    gates = technology.clock_gate[3] if technology.clock_gate else None
    return LinkedTiming(
        corner.name, clock_ps, uncertainty, round(float(slack[-1]) * unit_ps, 1), sum(value < 0 for value in negative),
        tuple(pairs(late, written.hierarchy, unit_ps)), round(sum(value for value in negative if value < 0), 1),
        round(min(holds, default=0.0) * unit_ps, 1), len(ends),
        sum(_MEMORY_PIN.search(line.split("\t")[2]) is not None for line in ends),
        len(nets), min(nets.values(), default=None), sum(pin.rpartition("/")[2] == gates for pin in bad), report,
        tuple(sorted(early_ports((line.split("\t")[2] for line in ends), written.hierarchy))))


def early_ports(pins: Iterable[str], hierarchy: Hierarchy) -> set[MemoryPort]:
    """The ports to memories among the pins that miss hold."""
    found = ((pin, _MEMORY_PIN.search(pin)) for pin in pins)
    return {(hierarchy.module(pin), f"{memory[1]}_{memory[2]}") for pin, memory in found if memory}


def _paths(text: str) -> list[str]:
    """The lines of paths in a section of the output."""
    return [line for line in text.splitlines() if "\t" in line]


def pairs(late: str, hierarchy: Hierarchy, unit_ps: float = 1.0) -> list[Pair]:
    """Late endpoints grouped by the pair of units that their paths begin and end in, the latest pair first.

    `late`: a line for each endpoint: its slack, the first and the last pin, and the places that the path passes; tabs between.
    """
    grouped: dict[tuple[str, str], list[tuple[float, str, str, str]]] = {}
    for line in _paths(late):
        slack, start, end, places = line.split("\t")
        if float(slack) < 0:
            ends = tuple("ports" if "/" not in pin else hierarchy.unit(pin) for pin in (start, end))
            grouped.setdefault(ends, []).append((float(slack) * unit_ps, start, end, places))
    found = []
    for (begin, finish), paths in grouped.items():
        slack, start, end, places = min(paths)
        through: list[str] = [begin]
        for place in (hierarchy.unit(place) for place in places.split(" ")):
            through += [place] if place != through[-1] else []
        through += [finish] if finish != through[-1] else []
        found.append(Pair(begin, finish, tuple(through), len(paths), round(slack, 1), start, end))
    return sorted(found, key=lambda pair: (pair.slack_ps, pair.start, pair.end))
