"""A mapped unit, placed: its timing with and without wires, what wires add to the load of pins, and its clock tree.

    wired = measure("pixel_core", settings, lef, density=0.8)

Both timing runs are of the same flat netlist under the constraints of `synth.timing`; nothing is sized or buffered after
placement, which a layout would do, so a long net that a flow would repair shows as it is. The clock is ideal in both.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from rtl.units import UNITS
from synth import flow, timing
from synth.design import elaborate
from synth.hints import config_of
from synth.liberty import Technology, find_files
from synth.netlist import read
from synth.once import run_once
from synth.physical.clock_tree import ClockTree, Sink, build
from synth.physical.lef import read_lef
from synth.physical.parasitics import ASAP7_WIRES, NO_WIRES, PinLoad, WireModel, Wires, route, write_spef
from synth.physical.placement import Placement, Terminal, place
from synth.power.cells import Cell, read_cells
from synth.power.electrical import CLOCK_SLEW
from synth.report import module_result
from synth.settings import Settings

CLOCK = "clk"


@dataclass(frozen=True)
class Wired:
    """A placed unit.

    Attributes:
        unit: its name.
        cells, flip_flops: number of its cells and flip-flops.
        cell_um2, die_um2: area of the cells, and of the die.
        density: the first over the second.
        nets: signal nets with two ends or more.
        wire_um: length of their wires.
        wire_ff, pin_ff: their capacitance, and that of the input pins that they lead to.
        slack_ps, wired_slack_ps: worst setup slack without and with wires.
        clock_ps: the clock.
        tree: of the clock that runs in every cycle; its sinks are flip-flops and clock gates.
        clock_fj: energy in its sinks in a cycle, with that inside their cells.
    """

    unit: str
    cells: int
    flip_flops: int
    cell_um2: float
    die_um2: float
    density: float
    nets: int
    wire_um: float
    wire_ff: float
    pin_ff: float
    slack_ps: float
    wired_slack_ps: float
    clock_ps: float
    tree: ClockTree
    clock_fj: float

    @property
    def wire_share(self) -> float:
        """Capacitance of the wires over that of the pins."""
        return self.wire_ff / self.pin_ff

    @property
    def derate(self) -> float:
        """The shortest clock period with wires over that without."""
        return (self.clock_ps - self.wired_slack_ps) / (self.clock_ps - self.slack_ps)

    @property
    def tree_share(self) -> float:
        """Energy of the clock tree over that of what it clocks."""
        return self.tree.tree_fj / self.clock_fj


def measure(unit: str, settings: Settings, lef: Path, density: float, effort: int = 3) -> Wired:
    """Maps a unit (its modules are taken from the cache where they are there), places it, and times it.

    Args:
        unit: name of a unit of `rtl.units`.
        settings: of its synthesis.
        lef: the LEF file of the library's cells.
        density, effort: see `synth.physical.placement.place`.

    Raises:
        InputError: a tool or file is missing, or a value is not accepted.
        RuntimeError: OpenSTA failed.
    """
    technology, liberty = settings.library()
    shapes = read_lef(lef)
    netlist_file, has_memories = _flat(unit, settings, liberty)
    netlist = read(netlist_file)
    cells = read_cells(find_files(technology), {instance.kind for instance in netlist.instances} | {_buffer(technology)})
    clocks = {CLOCK} | {instance.pins[technology.clock_gate[3]][0] for instance in netlist.instances
                        if instance.kind == technology.clock_gate[0]}
    placement = place(netlist, shapes, clocks, density, netlist_file.with_name("placement.log"), effort)
    wires = route(placement)

    def pin_ff(end: Terminal) -> float:
        if end.owner < 0:
            return 0.0 if end.drives else technology.load
        return 0.0 if end.drives else cells[netlist.instances[end.owner].kind].capacitance[end.name]

    slack, wired_slack = (
        _slack(netlist_file, (placement, wires, model, pin_ff), settings, has_memories) for model in (NO_WIRES, ASAP7_WIRES))
    return _result(unit, placement, wires, cells, technology, slack, wired_slack, settings.clock_ps)


def _flat(unit: str, settings: Settings, liberty: Path) -> tuple[Path, bool]:
    """The flat netlist of a unit, and whether memories were taken out of it."""
    design = elaborate(UNITS[unit].make(config_of(unit)), unit)
    parts: dict[str, dict] = {}
    for module in design.texts:
        parts[module] = module_result(design, module, [Path(part["netlist"]) for part in parts.values()], settings)
    folder = settings.folder / "placed" / unit
    folder.mkdir(parents=True, exist_ok=True)
    flat = folder / f"{unit}.v"
    flow.run(f"read_liberty -lib {liberty}", *(f"read_verilog {part['netlist']}" for part in parts.values()),
             f"hierarchy -top {unit}", "flatten", "splitnets", "opt_clean -purge",
             f"write_verilog -noattr -noexpr -simple-lhs {flat}", log=folder / "yosys.log")
    flat.write_text(re.sub(r"(?m)^(\s*(?:wire|input|output) )signed ", r"\1", flat.read_text()))
    return flat, any(part["memories"] for part in parts.values())


def _slack(netlist: Path, wired: tuple[Placement, Wires, WireModel, PinLoad], settings: Settings, memories: bool) -> float:
    """The worst slack in ps under a model of wires; the arguments of `write_spef` are in `wired`."""
    technology, liberty = settings.library()
    spef = netlist.with_suffix(f".{'pins' if wired[2] is NO_WIRES else 'wires'}.spef")
    write_spef(spef, *wired)
    commands = timing.preamble([netlist], netlist.stem, settings.clock_ps, technology, liberty, memories)
    commands += f"read_spef -pin_cap_included {spef}\nreport_worst_slack -digits 2\n"
    output = run_once(commands, [netlist, spef, liberty], netlist.parent, spef.stem)
    found = re.search(r"worst slack\s+(-?[\d.]+)", output)
    if found is None:
        raise RuntimeError(f"sta reported no slack:\n{output}")
    return float(found[1]) * technology.time_unit_ps


def _buffer(technology: Technology) -> str:
    return technology.broadcast_buffer[0]


def _result(
    unit: str, placement: Placement, wires: Wires, cells: dict[str, Cell], technology: Technology, slack: float,
    wired_slack: float, clock_ps: float,
) -> Wired:
    instances = placement.netlist.instances
    sinks, clock_fj = [], 0.0
    for end in placement.nets[CLOCK]:
        if end.owner >= 0:
            cell = cells[instances[end.owner].kind]
            sinks.append(Sink(end.x, end.y, cell.capacitance[end.name]))
            clock_fj += _inside(cell)
    tree = build(sinks, cells[_buffer(technology)], ASAP7_WIRES)
    pins = sum(cells[instances[end.owner].kind].capacitance[end.name] for bit in wires.trees
               for end in placement.nets[bit] if end.owner >= 0 and not end.drives)
    area = sum(cells[instance.kind].area for instance in instances)
    return Wired(
        unit, len(instances), sum(cells[instance.kind].kind == "flop" for instance in instances), area,
        placement.width * placement.height / 1e6, placement.density, len(wires.trees), wires.um,
        wires.um * ASAP7_WIRES.ff_per_um, pins, slack, wired_slack, clock_ps, tree, tree.sink_fj + clock_fj)


def _inside(cell: Cell) -> float:
    """Energy inside a clocked cell in a cycle in which its output stays, fJ."""
    return cell.passive["CLK"].at(CLOCK_SLEW)

