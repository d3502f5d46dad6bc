"""Synthesises a unit into a report; results are cached by everything that they depend on."""

from __future__ import annotations

import hashlib
import json
import os
from collections import Counter
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

from amaranth.lib import wiring

from rtl.units import TOP, UNITS
from spec.command_line import nearest
from spec.errors import InputError
from spec.private import locked
from spec.progress import phase
from synth import flow, timing
from synth.design import Design, elaborate
from synth.hints import BLOCKS, RESERVED_PS, SYNTHESISED, VARIANTS, config_of
from synth.liberty import ASAP7
from synth.mapping import to_cells, to_gates
from synth.memories import Macro, as_rows
from synth.settings import MOST_RUNS, Settings

HINTS = "asap7", 1000.0
"""Technology and clock for which the units' hints were found; elsewhere blocks are chosen as in any other unit."""


def synthesise_unit(
    name: str, technology: str, clock_ps: float, folder: Path, runs: int = MOST_RUNS,
) -> dict[str, object]:
    """The report of a unit and its variants; it is also written to `folder/NAME-TECHNOLOGY.json`.

    Raises:
        InputError: the unit or technology is unknown, the clock is not accepted, or Yosys or liberty files are missing.
    """
    if name == TOP:
        raise InputError(f"unit {name!r} is synthesised as a machine, unit by unit: give a config instead")
    if name not in SYNTHESISED:
        raise InputError(f"unit {name!r} is not known: {', '.join(SYNTHESISED)} are{nearest(name, SYNTHESISED)}")
    unit, config, settings = UNITS[name], config_of(name), Settings(technology, clock_ps, folder, runs=runs)
    settings.check()
    report: dict[str, object] = {"unit": name, "technology": technology, "config": config.name}
    report |= synthesise(unit.make(config), name, settings)
    report["variants"] = {
        label: synthesise(unit.make(other), name, settings) for label, other in VARIANTS.get(name, {}).items()}
    write_json(folder / f"{name}-{settings.label}.json", report)
    return report


def synthesise(component: wiring.Component, name: str, settings: Settings) -> dict[str, object]:
    """Area, cells, memories and timing of a component. Each of its shared modules is synthesised once and counted as often as
    used.

    Raises:
        InputError: Yosys or liberty files are missing.
    """
    settings.check()
    design = elaborate(component, name)
    counts = design.counts()
    parts: dict[str, dict] = {}
    for module in design.texts:  # lower ones first
        parts[module] = module_result(design, module, [Path(part["netlist"]) for part in parts.values()], settings)
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
    technology = settings.library()[0]
    result |= {"node": technology.node, "cell_list": technology.cell_list, "clock_ps": settings.clock_ps}
    return result | timed(name, parts, settings)


def _rounded(area: float, digits: int) -> float | int:
    return round(area, digits) if digits else round(area)


def timed(name: str, parts: Mapping[str, dict], settings: Settings) -> dict[str, object]:
    """Slack of a component including everything below it.

    `parts`: the `module_result` of each of its modules, lower ones first.
    """
    if not timing.available():
        return {"slack_ps": None, "zero_slack_ps": None, "derated_ps": None, "sta": None}
    netlists = [Path(part["netlist"]) for part in reversed(parts.values())]
    scratch = netlists[0].parent
    key = hashlib.sha256(repr(([path.parent.parent.name for path in netlists], settings.clock_ps)).encode()).hexdigest()[:16]
    cached = scratch / f"timing-{key}.json"
    with locked(scratch / "lock"):
        if not cached.exists():
            found = timing.analyse(
                netlists, name, settings.clock_ps, *settings.library(), scratch, bool(parts[name]["memories"]))
            path = scratch / f"path-{key}.txt"
            path.write_text(found.path)
            write_json(cached, {
                "slack_ps": found.slack_ps, "zero_slack_ps": round(found.zero_slack_ps, 1), "sta": found.version,
                "derated_ps": round(found.zero_slack_ps * timing.WIRE_DERATE, 1), "worst_path": str(path)})
    return json.loads(cached.read_text())


def module_result(
    design: Design, module: str, below: list[Path], settings: Settings, *, is_timed: bool = True,
) -> dict[str, object]:
    """Netlist, area and cells of one module, without the modules below it, whose netlists are given.

    `is_timed`: the module is timed. Otherwise its sums get UNTIMED_BUDGET, and its slack is null.
    """
    reserved = RESERVED_PS.get(module, 0.0) if settings.technology == ASAP7.name else 0.0
    settings = replace(settings, clock_ps=settings.clock_ps - reserved)
    source, boxes = design.source(module), tuple(sorted(design.below[module]))
    hinted = (settings.technology, settings.clock_ps) == HINTS
    blocks, below = BLOCKS.get(module) if hinted else None, below if boxes else []
    library = None
    if settings.technology != "generic":
        technology, liberty = settings.library()
        library = technology, liberty.name  # the file's name holds its hash, so its folder does not matter
    tools = flow.version(), timing.available() and is_timed, _flow_source()
    inputs = source, settings.technology, settings.clock_ps, settings.memory_limit, blocks, library, tools
    # A result that was made with more runs is accepted, too.
    accepted = dict.fromkeys((settings.runs,) if settings.exact else (MOST_RUNS, settings.runs))
    kept = [_kept(settings, module, inputs, runs) for runs in accepted]
    cached = next((path for path in kept if path.exists()), kept[-1])
    cached.parent.mkdir(parents=True, exist_ok=True)
    with locked(cached.parent / "lock"):  # another process that wants the same module waits for the result
        if not cached.exists():
            run = to_gates if settings.technology == "generic" else to_cells
            with phase(f"synthesising {module} ({settings.label})"):
                write_json(
                    cached, _in_fresh_process(run, module, source, boxes, cached.parent, below, blocks, settings, is_timed))
    found = json.loads(cached.read_text())
    return {**found, "slack_ps": found["slack_ps"] + reserved} if reserved and found["slack_ps"] is not None else found


def _kept(settings: Settings, module: str, inputs: tuple, runs: int) -> Path:
    key = hashlib.sha256(repr((inputs, runs)).encode()).hexdigest()[:16]
    return settings.folder / "cache" / f"{module}-{key}" / "result.json"


def _in_fresh_process(run: Callable[..., dict], *arguments: object) -> dict:
    """Call `run` in a new process.

    Yosys numbers its objects over the life of a process, and ABC's result depends on the numbers.

    Raises:
        RuntimeError: Yosys ended the process, as it does on an error.
    """
    try:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            return pool.submit(run, *arguments).result()
    except BrokenProcessPool as error:
        raise RuntimeError(f"Yosys failed: see {arguments[3]}/yosys.log") from error


def _flow_source() -> str:
    """The source text of the flow, part of the cache key. What a unit contributes is in its RTL and its hints."""
    return "".join(Path(__file__).with_name(f"{name}.py").read_text() for name in flow.SOURCES)


def write_json(path: Path, value: object) -> None:
    """Write a JSON file; it appears only when it is complete."""
    write_text(path, json.dumps(value, indent=1) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a text file; it appears only when it is complete."""
    path.parent.mkdir(parents=True, exist_ok=True)
    scratch = path.with_suffix(f".{os.getpid()}.tmp")
    scratch.write_text(text)
    scratch.replace(path)
