"""A whole machine's timing: the linked run at each corner, and the stored interfaces that the budget rule adds up.

    found = time_config(PAPER, folder=Path("build/synth"))
    found.linked["typical"].slack_ps, found.linked["slow"].ghz

The interfaces are kept in reports/machine_budget.json with a hash of the RTL that they were measured on. `stale` compares it
with the RTL of today, so that the rule cannot speak of a machine that no longer is.
"""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from spec.config import MACHINES, AcceleratorConfig
from spec.errors import InputError
from spec.paths import BUILD, REPORTS
from spec.sources import fingerprint, sources_of
from synth.area import mapped
from synth.budget import Late, graph, late
from synth.corners import CORNERS, UNCERTAINTY, corner
from synth.design import Design
from synth.discover import read_cells
from synth.hold import ROUNDS, MemoryPort, added, more
from synth.interfaces import Interface, interface_of, interfaced, measured, source_hash
from synth.linked import LinkedTiming, check, time_machine, write_machine
from synth.loads import Overload, memory_pins, overloads, pins_of
from synth.machine import TOP, machine_design
from synth.netlist import read
from synth.settings import MOST_RUNS, Settings

STORE = REPORTS / "machine_budget.json"
"""The stored interfaces, written by `msv2 study run machine_timing`."""

REFRESH = "msv2 study run machine_timing --keep"

BUDGET_CORNER = "typical"


@dataclass(frozen=True)
class WholeTiming:
    """The timing of a machine.

    Attributes:
        config: its name.
        linked: the linked run by corner.
        interfaces: the interfaces of its modules at the typical corner; empty if they were not asked for.
        sources: a hash of everything that the machine's RTL depends on.
        modules, instances: modules that were mapped, and how many instances of them the machine has.
        cells: cells of the linked machine.
        overloads: nets that are loaded beyond their driver's limit, the worst first.
        mapped_ps: the clock for which the modules were mapped; 0 where nothing is linked.
        logic_um2: area of all cells.
        hold_buffers: those of the cells that were put before memories' pins against misses of hold.
        hold_um2: their area, which is in no other report.
        measured: modules whose interfaces were measured for this; the others' are stored ones.
    """

    config: str
    linked: dict[str, LinkedTiming]
    interfaces: dict[str, Interface]
    sources: str
    modules: int
    instances: int
    cells: int
    overloads: tuple[Overload, ...] = ()
    mapped_ps: float = 0.0
    logic_um2: float = 0.0
    hold_buffers: int = 0
    hold_um2: float = 0.0
    measured: int = 0


def time_config(
    config: AcceleratorConfig, folder: Path = BUILD / "synth", jobs: int = 2, progress: Callable[[str], None] = print,
    runs: int = MOST_RUNS, corners: Sequence[str] = tuple(CORNERS), clock_ps: float = 1000.0, uncertainty: float = UNCERTAINTY,
    *, interfaces: bool = False,
) -> WholeTiming:
    """Maps all modules of a machine, links them, and times the whole at each corner. Modules are mapped for what the
    uncertainty leaves of the clock, so that what fits into one by itself fits into the machine as well.

    `interfaces`: the modules' interfaces are measured as well.

    Raises:
        InputError: a corner is not known, or OpenSTA, Yosys or liberty files are missing.
    """
    check()
    wanted = [corner(name) for name in corners]
    settings = Settings("asap7", clock_ps * (1 - uncertainty), folder, runs=runs)
    design, parts = mapped(config, settings, jobs, progress)
    place = folder / f"machine-{config.name}"

    def time(held: Mapping[MemoryPort, int]) -> dict[str, LinkedTiming]:
        progress(f"{config.name}: linking and timing the machine"
                 f"{f', with buffers before {len(held)} ports to memories' if held else ''}")
        return {one.name: time_machine(design, parts, one, place, clock_ps, uncertainty, held) for one in wanted}

    linked, held = without_early_ports(time)
    written = write_machine(design, parts, wanted[0], place, held)
    counts = design.counts()
    cells = pins_of(wanted[0].liberty(folder)) | memory_pins(written.cells)
    netlists = [read(path) for path in written.netlists]
    loaded = overloads(netlists, cells)
    put, buffer = added(netlists, counts), wanted[0].technology.broadcast_buffer[0]
    areas = {cell.name: cell.area for cell in read_cells(wanted[0].liberty(folder))[1]}
    ports = _interfaces(design, interfaced(design), parts, folder / f"interfaces-{config.name}", progress) if interfaces else {}
    return WholeTiming(
        config.name, linked, ports, _sources(config), len(design.texts), counts.total(),
        put + sum(counts[name] * sum(part["cells_by_type"].values()) for name, part in parts.items()), tuple(loaded),
        settings.clock_ps, sum(counts[name] * part["area"] for name, part in parts.items()), put,
        round(put * areas.get(buffer, 0.0), 1))


def without_early_ports(
    time: Callable[[Mapping[MemoryPort, int]], dict[str, LinkedTiming]],
) -> tuple[dict[str, LinkedTiming], dict[MemoryPort, int]]:
    """The timing of a machine at each corner, with as many buffers as keep the pins of its memories from being too early, and
    these buffers. `time` gives the timing with such buffers."""
    held: dict[MemoryPort, int] = {}
    linked = time(held)
    for _ in range(ROUNDS):
        early = {port for one in linked.values() for port in one.early}
        if not early:
            break
        held = more(held, early)
        linked = time(held)
    return linked, held


def time_ports(
    config: AcceleratorConfig, kept: Budget, folder: Path = BUILD / "synth", jobs: int = 2,
    progress: Callable[[str], None] = print, runs: int = MOST_RUNS,
) -> WholeTiming:
    """Maps and measures those modules alone whose RTL is no longer that of the stored interfaces, and links nothing.

    Raises:
        InputError: OpenSTA, Yosys or liberty files are missing.
    """
    check()
    settings = Settings("asap7", kept.clock_ps * (1 - kept.uncertainty), folder, runs=runs)
    design = machine_design(config, folder)
    old = _changed(kept, design)
    progress(f"{config.name}: {len(old)} modules have changed")
    _, parts = mapped(config, settings, jobs, progress, {module for name in old for module in measured(design, name)})
    new = _interfaces(design, old, parts, folder / f"interfaces-{config.name}", progress)
    return WholeTiming(
        config.name, {}, {name: new.get(name) or kept.interfaces[name] for name in interfaced(design)}, _sources(config),
        len(design.texts), design.counts().total(), 0, measured=len(old))


def _interfaces(
    design: Design, names: Iterable[str], parts: Mapping[str, dict], folder: Path, progress: Callable[[str], None],
) -> dict[str, Interface]:
    found = {}
    for name in names:
        progress(f"measuring the ports of {name}")
        found[name] = interface_of(name, design, parts, CORNERS[BUDGET_CORNER], folder)
    return found


def _changed(budget: Budget, design: Design) -> list[str]:
    """The modules of a design that have interfaces, but not those that are stored."""
    return [name for name in interfaced(design)
            if name not in budget.interfaces or source_hash(design, name) != budget.interfaces[name].source]


def _sources(config: AcceleratorConfig) -> str:
    return fingerprint(sources_of("synth.machine"), config, importlib.metadata.version("amaranth"))


@dataclass(frozen=True)
class Budget:
    """The stored interfaces of a machine, with the clock and the uncertainty that the rule is for."""

    config: str
    clock_ps: float
    uncertainty: float
    sources: str
    interfaces: dict[str, Interface]

    def late(self) -> list[Late]:
        """The pairs of units that do not fit into the clock, the worst first."""
        return late(graph(self.interfaces, TOP, self.clock_ps), self.clock_ps, self.uncertainty)


def stored(found: Sequence[WholeTiming], clock_ps: float, uncertainty: float) -> dict[str, object]:
    """What STORE holds of some machines; interfaces that machines share are there once."""
    interfaces = {f"{name} {one.source}": one for whole in found for name, one in whole.interfaces.items()}
    return {
        "clock_ps": clock_ps, "uncertainty": uncertainty, "corner": BUDGET_CORNER,
        "machines": {whole.config: {"sources": whole.sources, "modules": {
            name: one.source for name, one in whole.interfaces.items()}} for whole in found},
        "interfaces": {key: asdict(one) for key, one in sorted(interfaces.items())}}


def budgets(path: Path = STORE) -> dict[str, Budget]:
    """The stored interfaces, by machine.

    Raises:
        InputError: the file is missing.
    """
    if not path.is_file():
        raise InputError(f"{path.name} is missing: `{REFRESH}` writes it")
    kept = json.loads(path.read_text())
    return {
        name: Budget(name, kept["clock_ps"], kept["uncertainty"], machine["sources"], {
            module: Interface(**kept["interfaces"][f"{module} {source}"]) for module, source in machine["modules"].items()})
        for name, machine in kept["machines"].items()}


def stale(budget: Budget, folder: Path = BUILD / "synth") -> list[str]:
    """The modules whose RTL is no longer the one that was measured; empty if the budget is of today's machine.

    The machine is elaborated only where a source changed on which its RTL depends.
    """
    config = MACHINES[budget.config]
    if _sources(config) == budget.sources:
        return []
    design = machine_design(config, folder)
    return sorted({*_changed(budget, design), *(budget.interfaces.keys() - interfaced(design).keys())})
