"""Synthesis of a unit into a report, cached by everything the result depends on."""

from __future__ import annotations

import hashlib
import json
import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from math import inf
from multiprocessing import get_context
from pathlib import Path

from amaranth.lib import wiring

from spec.errors import InputError
from synth import flow, timing
from synth.design import Design, elaborate
from synth.liberty import ASAP7, find_files, merge
from synth.memories import LIMIT, Macro, as_rows
from synth.units import UNITS

TECHNOLOGIES = ("generic", "asap7")

FASTER, MOST_RUNS = 0.8, 6
"""Step by which sums on paths with negative slack are made faster, and how often."""

UNTIMED_BUDGET = 500.0
"""Estimated ps that a sum may take where no slack is known."""

Blocks = Mapping[str, Sequence[int]]


def synthesise_unit(name: str, technology: str, clock_ps: float, folder: Path) -> dict[str, object]:
    """The report of a unit and its variants; also written to `folder/NAME-TECHNOLOGY.json`.

    Raises:
        InputError: unknown unit or technology, a clock that is not positive, Yosys or liberty files absent.
    """
    if name not in UNITS:
        raise InputError(f"unit {name!r} is not known: {', '.join(UNITS)} are")
    if technology not in TECHNOLOGIES:
        raise InputError(f"technology {technology!r} is not known: {', '.join(TECHNOLOGIES)} are")
    if not 1 <= clock_ps <= 1e6:
        raise InputError(f"a clock of {clock_ps!r} ps is not accepted: 1 to 1,000,000 is")
    unit, settings = UNITS[name], Settings(technology, clock_ps, folder)
    _check_tools(settings)
    report: dict[str, object] = {"unit": name, "technology": technology, "config": unit.config.name}
    report |= synthesise(unit.make(unit.config), name, settings)
    report["variants"] = {label: synthesise(unit.make(config), name, settings) for label, config in unit.variants.items()}
    write_json(folder / f"{name}-{technology}.json", report)
    return report


@dataclass(frozen=True)
class Settings:
    """Of a synthesis.

    Attributes:
        technology, clock_ps: as above.
        folder: of the cache.
        memory_limit: bits of the largest memory that is made of flip-flops.
    """

    technology: str
    clock_ps: float
    folder: Path
    memory_limit: int = LIMIT


def synthesise(component: wiring.Component, name: str, settings: Settings) -> dict[str, object]:
    """Area, cells, memories and timing of a component; its shared modules are synthesised once each and added up.

    Raises InputError where Yosys or liberty files are absent.
    """
    _check_tools(settings)
    design = elaborate(component, name)
    counts = design.counts()
    parts: dict[str, dict] = {}
    for module in design.texts:  # lower ones first
        parts[module] = _module(design, module, [Path(part["netlist"]) for part in parts.values()], settings)
    unit = "nand2_equivalents" if settings.technology == "generic" else "area_um2"
    area = sum(counts[module] * part["area"] for module, part in parts.items())
    own, digits = parts[name], 0 if settings.technology == "generic" else 2
    suffix = "" if settings.technology == "generic" else "_um2"
    memories: Counter[Macro] = Counter()
    for module, part in parts.items():
        for row in part["memories"]:
            memories[Macro(*(row[key] for key in ("words", "width", "reads", "writes")))] += counts[module] * row["count"]
    result = {
        "area_um2": None, unit: _rounded(area, digits), f"without_modules_below{suffix}": _rounded(own["area"], digits),
        "modules_below": {
            module: {"count": counts[module], "area": _rounded(part["area"], digits), "slack_ps": part["slack_ps"]}
            for module, part in parts.items() if module != name},
        "memory_bits": sum(count * macro.bits for macro, count in memories.items()), "memories": as_rows(memories),
        "flip_flops": sum(
            counts[module] * count for module, part in parts.items() for kind, count in part["cells_by_type"].items()
            if "DFF" in kind),
        "cells": sum(own["cells_by_type"].values()), "cells_by_type": own["cells_by_type"], "sums": own["sums"],
        "yosys": flow.version(), "clock_ps": None, "slack_ps": None,
    }
    if settings.technology == "generic":
        return result
    if "pixel_core" in design.below and name != "pixel_core":
        result["area_per_core_um2"] = round(area / counts["pixel_core"], 2)
    result |= {"node": ASAP7.node, "cell_list": ASAP7.cell_list, "clock_ps": settings.clock_ps}
    return result | _timed(name, parts, settings)


def _check_tools(settings: Settings) -> None:
    """InputError where Yosys or liberty files are absent."""
    if flow.libyosys is None:
        raise InputError("pyosys is not installed: the extra `synth` is wanted (pip install -e '.[synth]')")
    if settings.technology == "asap7":
        find_files(ASAP7)


def _rounded(area: float, digits: int) -> float | int:
    return round(area, digits) if digits else round(area)


def _timed(name: str, parts: dict[str, dict], settings: Settings) -> dict[str, object]:
    """Slack of a component with all that is below it."""
    if not timing.available():
        return {"slack_ps": None, "zero_slack_ps": None, "derated_ps": None, "sta": None}
    netlists = [Path(part["netlist"]) for part in reversed(parts.values())]
    scratch = netlists[0].parent
    key = hashlib.sha256(repr((netlists, settings)).encode()).hexdigest()[:16]
    cached = scratch / f"timing-{key}.json"
    if not cached.exists():
        found = timing.analyse(
            netlists, name, settings.clock_ps, ASAP7, _liberty(settings.folder), scratch, bool(parts[name]["memories"]))
        path = scratch / f"path-{key}.txt"
        path.write_text(found.path)
        write_json(cached, {
            "slack_ps": found.slack_ps, "zero_slack_ps": round(found.zero_slack_ps, 1), "sta": found.version,
            "derated_ps": round(found.zero_slack_ps * timing.WIRE_DERATE, 1), "worst_path": str(path)})
    return json.loads(cached.read_text())


def _module(design: Design, module: str, below: list[Path], settings: Settings) -> dict[str, object]:
    """Netlist, area and cells of one module without those below it, whose netlists are given."""
    source, boxes = design.source(module), tuple(sorted(design.below[module]))
    unit = UNITS.get(module)
    blocks, below = unit.blocks if unit else None, below if boxes else []
    files = [(path.name, path.stat().st_size) for path in find_files(ASAP7)] if settings.technology == "asap7" else None
    clock = settings.clock_ps if blocks is None else None
    tools = flow.version(), timing.available(), _flow_source()
    inputs = source, settings.technology, clock, settings.memory_limit, blocks, files, tools
    key = hashlib.sha256(repr(inputs).encode()).hexdigest()[:16]
    cached = settings.folder / "cache" / f"{module}-{key}" / "result.json"
    if not cached.exists():
        run = _generic if settings.technology == "generic" else _asap7
        write_json(cached, _in_fresh_process(run, module, source, boxes, cached.parent, below, blocks, settings))
    return json.loads(cached.read_text())


def _in_fresh_process(run: Callable[..., dict], *arguments: object) -> dict:
    """Call `run` in a new process: Yosys numbers its objects over a process's life, and ABC's result depends on the numbers.

    Raises RuntimeError where Yosys ended the process, as it does on an error.
    """
    try:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            return pool.submit(run, *arguments).result()
    except BrokenProcessPool as error:
        raise RuntimeError(f"Yosys failed: see {arguments[3]}/yosys.log") from error


def _generic(
    name: str, source: str, boxes: Sequence[str], scratch: Path, below: list[Path], blocks: Blocks | None, settings: Settings,
) -> dict:
    return _as_result(flow.count_nand2(source, name, scratch, boxes, settings.memory_limit), None)


def _asap7(
    name: str, source: str, boxes: Sequence[str], scratch: Path, below: list[Path], blocks: Blocks | None, settings: Settings,
) -> dict:
    """With hints as they say. Without, sums on late paths are made faster, a step a run, while the clock is not met and they
    can be; the run with most slack counts."""
    liberty, found, timed = _liberty(settings.folder), [], timing.available()
    budgets = {} if timed else {"": UNTIMED_BUDGET}
    while True:
        folder = scratch / f"run{len(found)}"
        netlist = flow.synthesise(source, name, ASAP7, liberty, folder, blocks or {}, boxes, budgets, settings.memory_limit)
        if not timed:
            return _as_result(netlist, None)
        netlists = [*below, netlist.verilog]
        seen = timing.analyse(netlists, name, settings.clock_ps, ASAP7, liberty, folder, bool(netlist.memories))
        found.append((min(seen.slack_ps, 0.0), -netlist.area, netlist, seen.slack_ps))
        late = {}
        for label in seen.late_sums & set(netlist.sums):
            if netlist.sums[label].time <= budgets.get(label, inf):  # else it is as fast as it can be
                late[label] = FASTER * netlist.sums[label].time
        if blocks is not None or not late or len(found) == MOST_RUNS:
            break
        budgets |= late
    return _as_result(*max(found, key=lambda run: run[:2])[2:])


def _as_result(netlist: flow.Netlist, slack_ps: float | None) -> dict:
    sums = {label: cut._asdict() for label, cut in netlist.sums.items() if cut.blocks}
    return {"area": netlist.area, "cells_by_type": netlist.cells, "memories": as_rows(netlist.memories), "sums": sums,
            "slack_ps": slack_ps, "netlist": str(netlist.verilog)}


def _liberty(folder: Path) -> Path:
    return merge(ASAP7, folder / "cache" / f"asap7-{hashlib.sha256(repr(ASAP7).encode()).hexdigest()[:8]}.lib")


def _flow_source() -> str:
    """The flow's own source: a changed flow is a changed result. What of the units matters is in their RTL and their hints."""
    files = sorted(path for path in Path(__file__).parent.glob("*.py") if path.name not in ("__main__.py", "units.py"))
    return "".join(path.read_text() for path in files)


def write_json(path: Path, value: object) -> None:
    """Write JSON, whole or not at all."""
    write_text(path, json.dumps(value, indent=1) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a file, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    scratch = path.with_suffix(f".{os.getpid()}.tmp")
    scratch.write_text(text)
    scratch.replace(path)
