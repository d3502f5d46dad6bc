"""Synthesis of a unit into a report, cached by everything the result depends on."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path

from rtl.emit import to_rtlil
from spec.config import AcceleratorConfig
from spec.errors import InputError
from synth import flow, timing
from synth.liberty import ASAP7, find_files, merge
from synth.units import UNITS, Unit

TECHNOLOGIES = ("generic", "asap7")


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
    if flow.libyosys is None:
        raise InputError("pyosys is not installed: the extra `synth` is wanted (pip install -e '.[synth]')")
    unit = UNITS[name]
    report: dict[str, object] = {"unit": name, "technology": technology, "config": unit.config.name}
    report |= _one(name, unit, unit.config, technology, clock_ps, folder)
    report["variants"] = {
        label: _one(name, unit, config, technology, clock_ps, folder) for label, config in unit.variants.items()
    }
    write_json(folder / f"{name}-{technology}.json", report)
    return report


def _one(name: str, unit: Unit, config: AcceleratorConfig, technology: str, clock_ps: float, folder: Path) -> dict[str, object]:
    """Area, cells and timing of a unit in one configuration."""
    rtlil = to_rtlil(unit.make(config), name)
    liberties = [(path.name, path.stat().st_size) for path in find_files(ASAP7)] if technology == "asap7" else None
    tools = flow.version(), timing.available(), _flow_source()
    inputs = rtlil, technology, clock_ps, unit.blocks, unit.boxes, liberties, tools
    key = hashlib.sha256(repr(inputs).encode()).hexdigest()[:16]
    cached = folder / "cache" / f"{name}-{key}" / "result.json"
    if not cached.exists():
        run = _generic if technology == "generic" else _asap7
        write_json(cached, _in_fresh_process(run, name, rtlil, clock_ps, cached.parent, folder))
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


def _generic(name: str, rtlil: str, clock_ps: float, scratch: Path, folder: Path) -> dict:
    unit = UNITS[name]
    netlist = flow.count_nand2(rtlil, name, scratch, tuple(unit.boxes))
    below = {box: n * flow.count_nand2(rtlil, box, scratch).area for box, n in unit.boxes.items()}
    return {"nand2_equivalents": round(netlist.area + sum(below.values())), "without_modules_below": round(netlist.area),
            "cells": sum(netlist.cells.values()), "cells_by_type": netlist.cells, "area_um2": None, "clock_ps": None,
            "slack_ps": None, "yosys": flow.version()}


def _asap7(name: str, rtlil: str, clock_ps: float, scratch: Path, folder: Path) -> dict:
    unit = UNITS[name]
    liberty = merge(ASAP7, folder / "cache" / f"asap7-{hashlib.sha256(repr(ASAP7).encode()).hexdigest()[:8]}.lib")
    netlist = flow.synthesise(rtlil, name, ASAP7, liberty, scratch, unit.blocks, tuple(unit.boxes))
    netlists, area = [netlist.verilog], netlist.area
    for box, count in unit.boxes.items():
        below = flow.synthesise(rtlil, box, ASAP7, liberty, scratch, UNITS[box].blocks)
        netlists.append(below.verilog)
        area += count * below.area
    result = {
        "area_um2": round(area, 2), "without_modules_below_um2": round(netlist.area, 2), "cells": sum(netlist.cells.values()),
        "cells_by_type": netlist.cells, "node": ASAP7.node, "cell_list": ASAP7.cell_list, "yosys": flow.version(),
        "clock_ps": clock_ps, "slack_ps": None, "zero_slack_ps": None, "derated_ps": None, "sta": None,
    }
    if unit.boxes:
        result["area_per_core_um2"] = round(area / sum(unit.boxes.values()), 2)
    if timing.available():
        found = timing.analyse(netlists, name, clock_ps, ASAP7, liberty, scratch)
        (scratch / "path.txt").write_text(found.path)
        result |= {"slack_ps": found.slack_ps, "zero_slack_ps": round(found.zero_slack_ps, 1), "sta": found.version,
                   "derated_ps": round(found.zero_slack_ps * timing.WIRE_DERATE, 1), "worst_path": str(scratch / "path.txt")}
    return result


def _flow_source() -> str:
    """The flow's own source: a changed flow is a changed result."""
    return "".join(path.read_text() for path in sorted(Path(__file__).parent.glob("*.py")))


def write_json(path: Path, value: object) -> None:
    """Write JSON, whole or not at all."""
    write_text(path, json.dumps(value, indent=1) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a file, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    scratch = path.with_suffix(f".{os.getpid()}.tmp")
    scratch.write_text(text)
    scratch.replace(path)
