"""Area of a whole machine: the logic of every unit and every memory, by group, in the library's node and at 16 nm.

    report = machine_area(PAPER, "asap7", 1000.0, folder=Path("build/synth"))
    report.total_mm2_16nm()
"""

from __future__ import annotations

import re
import threading
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path

from spec.config import AcceleratorConfig
from spec.paths import BUILD
from synth.design import Design
from synth.machine import GROUPS, TOP, UNIT_GROUPS, UNTIMED, WARP, label, machine_design
from synth.macros import make
from synth.memories import Macro
from synth.report import module_result, timed
from synth.scaling import SOURCE, TO_16NM
from synth.settings import MOST_RUNS, Settings

MEMORY_NODE = "asap7"
"""Technology of the macros' areas. With another one, a memory is given the area that scales to the same area at 16 nm."""

CORES = ("pixel_core", "batch_core")
"""Modules that are a pixel core, of which a machine has one: the second's state can be loaded."""

_UM2_PER_MM2 = 1e6


@dataclass(frozen=True)
class MemoryRow:
    """A memory of the machine.

    Attributes:
        name: path below the machine.
        unit, group: the unit that it belongs to, and that unit's group.
        count: number of instances.
        words, width, reads, writes, bits: words, bits of a word, read ports, write ports, and bits of one instance.
        kind: "macros", "flip-flops" (if an array of them is smaller than macros), or what it became in the unit's logic, whose
            area is then not counted here.
        macros: number of macros by name, for all instances together.
        area_um2, area_um2_16nm: area of all instances together; null without a library.
        source: how the area was found.
    """

    name: str
    unit: str
    group: str
    count: int
    words: int
    width: int
    reads: int
    writes: int
    bits: int
    kind: str
    macros: dict[str, int]
    area_um2: float | None
    area_um2_16nm: float | None
    source: str

    @property
    def warp(self) -> bool:
        """Whether only machines with stereo have this memory."""
        return self.group == WARP


@dataclass(frozen=True)
class UnitRow:
    """A unit of the machine.

    Attributes:
        unit: path below the machine; "msv2_top" stands for the logic that is in no other unit.
        group: one of GROUPS.
        logic_um2: area of its cells, including those of its shared modules; NAND2 equivalents for the generic technology.
        own_um2: the same without shared modules.
        parts: the shared modules, with their count and the area of one.
        cells, flip_flops: number of cells and of flip-flops in all its logic.
        slack_ps: slack including its shared modules; null for a unit that is mere wiring, or without OpenSTA.
        worst_path: file that holds the path with this slack.
        memory_bits, memory_um2: size and area of its memories.
        factor, factor_source: factor from its area to the area at 16 nm, and where it is from.
        logic_um2_16nm, memory_um2_16nm: the areas at 16 nm.
        note: a remark on these numbers.
    """

    unit: str
    group: str
    logic_um2: float
    own_um2: float
    parts: dict[str, dict[str, float]]
    cells: int
    flip_flops: int
    slack_ps: float | None
    worst_path: str | None
    memory_bits: int
    memory_um2: float | None
    factor: float | None
    factor_source: str
    logic_um2_16nm: float | None
    memory_um2_16nm: float | None
    note: str = ""


@dataclass(frozen=True)
class AreaReport:
    """The area of a machine.

    Attributes:
        config, stereo, row_width: the machine.
        technology, node, cell_list, clock_ps: how it was synthesised.
        rows, memories: every unit and every memory.
        modules: area, slack and count of every module that was synthesised.
    """

    config: str
    stereo: bool
    row_width: int
    technology: str
    node: str
    cell_list: str
    clock_ps: float
    rows: tuple[UnitRow, ...]
    memories: tuple[MemoryRow, ...]
    modules: dict[str, dict[str, object]] = field(repr=False)

    @property
    def scales(self) -> bool:
        """Whether the factors of this technology to 16 nm are known."""
        return self.technology in TO_16NM

    def groups(self) -> dict[str, dict[str, float]]:
        """For each group the sums of areas, areas at 16 nm, memory bits, cells and flip-flops."""
        keys = ("logic_um2", "memory_um2", "logic_um2_16nm", "memory_um2_16nm", "memory_bits", "cells", "flip_flops")
        return {group: {key: sum(getattr(row, key) or 0 for row in self.rows if row.group == group) for key in keys}
                for group in GROUPS if any(row.group == group for row in self.rows)}

    def total_mm2_16nm(self, *, memories: bool = True, warp_memories: bool = True) -> float:
        """Total area in mm^2 at 16 nm; on request without any memories, or without those of the warp unit."""
        logic = sum(row.logic_um2_16nm for row in self.rows)
        held = sum(row.area_um2_16nm for row in self.memories if memories and (warp_memories or not row.warp))
        return (logic + held) / _UM2_PER_MM2

    def core_um2_16nm(self) -> float:
        """Area of the array and its setup unit per pixel core, in um^2 at 16 nm; without blending and memories."""
        array = sum(row.logic_um2_16nm for row in self.rows if row.group == GROUPS[0])
        return array / sum(self.modules[core]["count"] for core in CORES if core in self.modules)

    def worst_slack_ps(self) -> float | None:
        """The smallest slack of all units that are timed."""
        return min((row.slack_ps for row in self.rows if row.slack_ps is not None), default=None)

    def as_json(self) -> dict[str, object]:
        """The whole report as a dictionary."""
        return asdict(self)


def machine_area(
    config: AcceleratorConfig, technology: str = "asap7", clock_ps: float = 1000.0, folder: Path = BUILD / "synth",
    jobs: int = 2, progress: Callable[[str], None] = print, runs: int = MOST_RUNS, exact: bool = False,
) -> AreaReport:
    """Synthesise every unit of a machine, `jobs` at a time, each at most `runs` times. Results found in `folder` are reused.

    `exact`: do not reuse a result that was made with more runs.

    Raises:
        InputError: the technology is unknown, the clock is not accepted, or Yosys or liberty files are missing.
    """
    settings = Settings(technology, clock_ps, folder, runs=runs, exact=exact)
    design, parts = mapped(config, settings, jobs, progress)
    memories = tuple(_memory_rows(design, parts, technology))
    rows = tuple(_unit_row(path, group, design, parts, memories, settings)
                 for path, group in UNIT_GROUPS.items() if label(path) in design.texts)
    library = settings.library()[0] if technology != "generic" else None
    counts, kept = design.counts(), ("area", "slack_ps")
    modules = {name: {"count": counts[name], **{key: part[key] for key in kept}} for name, part in parts.items()}
    return AreaReport(
        config.name, config.stereo, config.row_width, settings.label, library.node if library else "NAND2 equivalents",
        library.cell_list if library else "two-input NAND, inverter, flip-flop", clock_ps, rows, memories, modules)


def mapped(
    config: AcceleratorConfig, settings: Settings, jobs: int = 2, progress: Callable[[str], None] = print,
    only: Collection[str] | None = None,
) -> tuple[Design, dict[str, dict]]:
    """The modules of a machine, and the `module_result` of each, `jobs` of them made at a time.

    `only`: the modules that are wanted; those in them are made as well, all others are left out. None: all.

    Raises:
        InputError: the settings are not accepted, or Yosys or liberty files are missing.
    """
    settings.check()
    progress(f"{config.name}: elaborating the machine")
    design = machine_design(config, settings.folder)
    names = [name for name in design.texts if only is None or name in only]
    return design, _synthesise_all(design, names, settings, jobs, progress)


def below(design: Design, name: str) -> list[str]:
    """All modules contained in a module, at any depth, lower ones first."""
    wanted = {name}
    for module in reversed(design.texts):
        if module in wanted:
            wanted |= set(design.below[module])
    return [module for module in design.texts if module in wanted and module != name]


def _synthesise_all(
    design: Design, wanted: Sequence[str], settings: Settings, jobs: int, progress: Callable[[str], None],
) -> dict[str, dict]:
    """The `module_result` of every module that is wanted, with the timing of the whole unit added under "timed"."""
    units = {label(path): path for path in UNIT_GROUPS}
    inside = {module for name in wanted for module in below(design, name) if units.get(name, name) not in UNTIMED}
    names = [name for name in design.texts if name in inside | set(wanted)]
    done, lock, began = [0], threading.Lock(), time.monotonic()
    results: dict[str, Future] = {}

    def work(name: str) -> dict:
        is_timed = units.get(name, name) not in UNTIMED
        parts = {module: results[module].result() for module in below(design, name)} if is_timed else {}
        netlists = [Path(part["netlist"]) for part in parts.values()]
        part = module_result(design, name, netlists, settings, is_timed=is_timed)
        part["timed"] = {"slack_ps": part["slack_ps"]}
        if name in units and is_timed and part["slack_ps"] is not None and (parts or part["slack_ps"] < 0):
            # Times the unit with everything below it; a module with negative slack is timed again to store its worst path.
            part["timed"] = timed(name, {**parts, name: part}, settings)
        with lock:
            done[0] += 1
            slack = part["timed"]["slack_ps"]
            progress(f"[{done[0]}/{len(names)}] {name}: {part['area']:,.0f}"
                     f"{'' if slack is None else f', slack {slack:.0f} ps'} ({time.monotonic() - began:.0f} s)")
        return part

    with ThreadPoolExecutor(max(1, jobs)) as pool:
        for name in names:  # lower ones first, so that what a job waits for was submitted before it
            results[name] = pool.submit(work, name)
        try:
            return {name: result.result() for name, result in results.items()}
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def shared_in(design: Design, name: str) -> Counter[str]:
    """How many instances of which shared modules a unit contains at any depth, not counting those inside other units."""
    units, found = {label(path) for path in UNIT_GROUPS}, Counter({name: 1})
    for module in reversed(design.texts):
        for box, count in design.below[module].items():
            if box not in units and found[module]:
                found[box] += found[module] * count
    del found[name]
    return found


def _memory_rows(design: Design, parts: dict[str, dict], technology: str) -> Iterable[MemoryRow]:
    for path, group in UNIT_GROUPS.items():
        name = label(path)
        if name not in design.texts:
            continue
        for module, count in [(name, 1), *sorted(shared_in(design, name).items())]:
            for store in parts[module]["stores"]:
                inner = re.sub(r"\$flatten\\|\$auto\$\S*|\$\d+", "", store["name"]).strip(".") or "table"
                inner = inner if module == name else f"{module}.{inner}"
                yield _memory_row(".".join(filter(None, (path, inner))), path or TOP, group, count, store, technology)


def _memory_row(name: str, unit: str, group: str, count: int, store: dict, technology: str) -> MemoryRow:
    shape = Macro(*(store[key] for key in ("words", "width", "reads", "writes")))
    kind, macros, area, source = store["made_as"], {}, 0.0, "in the unit's logic"
    if kind == "macro":
        made = make(shape)
        kind, area, source = made.kind, count * made.area_um2, made.source
        macros = {macro: count * number for macro, number in made.macros.items()}
    scaled, here = area * TO_16NM[MEMORY_NODE].area, _factor(technology)
    if technology != MEMORY_NODE:
        source += "; of ASAP7's node, scaled"
        area = scaled / here if here else None
    return MemoryRow(name, unit, group, count, **asdict(shape), bits=shape.bits, kind=kind, macros=macros, area_um2=area,
                     area_um2_16nm=scaled, source=source)


def _factor(technology: str) -> float | None:
    return TO_16NM[technology].area if technology in TO_16NM else None


def _unit_row(
    path: str, group: str, design: Design, parts: dict[str, dict], memories: tuple[MemoryRow, ...], settings: Settings,
) -> UnitRow:
    name, factor = label(path), _factor(settings.technology)
    shared = shared_in(design, name)
    counted = [(parts[name], 1), *((parts[module], count) for module, count in shared.items())]
    logic = sum(count * part["area"] for part, count in counted)
    held = [row for row in memories if row.unit == (path or TOP) and row.area_um2_16nm]
    area = [row.area_um2 for row in held]
    cores = sum(shared[core] for core in CORES)
    note = f"{cores} equal cores, one synthesised; slack of the slowest module" if cores else ""
    slack = parts[name]["timed"]["slack_ps"]
    if slack is None:  # the unit is too large to be timed as a whole, or mere wiring
        slack = min((parts[module]["slack_ps"] for module in shared if parts[module]["slack_ps"] is not None), default=None)
    return UnitRow(
        path or TOP, group, logic, parts[name]["area"],
        {module: {"count": count, "area": parts[module]["area"]} for module, count in sorted(shared.items())},
        sum(count * sum(part["cells_by_type"].values()) for part, count in counted),
        sum(count * number for part, count in counted for kind, number in part["cells_by_type"].items() if _is_flop(kind)),
        slack, parts[name]["timed"].get("worst_path"),
        sum(row.count * row.bits for row in held), None if None in area else sum(area), factor,
        SOURCE if factor else "", None if factor is None else logic * factor, sum(row.area_um2_16nm for row in held), note)


def _is_flop(kind: str) -> bool:
    return "DFF" in kind


