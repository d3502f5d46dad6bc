"""One point of a sweep: cycles by the model, area and energy by the unit tables.

A process keeps what points share: the loaded scene, the plan of its effects and the golden frame's trace. Points that draw the
same pixels, on whatever machine, share one trace.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import json
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

from golden.msv2_ref.plan import plan_for, planned_machine
from golden.scenes.request import Request, resolve
from msv2.studies.area.estimate import CULLING_REPORT, ESTIMATE, NO_AREA, REPORT, SYNTHESIS_REPORT, SYNTHESISED, estimate_area
from msv2.studies.energy.modelled import modelled_energy
from msv2.studies.energy.table import TABLE, Table, load_table
from msv2.sweep.points import Point
from perf.__main__ import CACHE, Asked, simulated, traced
from perf.frames import Trace
from perf.trace import trace_key
from spec.config import PAPER, AcceleratorConfig
from spec.effects import EffectPlan
from spec.errors import InputError
from spec.overrides import config_record
from spec.recent import Recent
from spec.sources import fingerprint, sources_of

TRACES_KEPT = 4
"""Traces that a process keeps; one of a Full HD frame takes some hundred megabytes."""

_OF_THE_MACHINE = ("config", "sets", "bandwidth", "latency", "memory", "merge", "beta", "pipeline", "machine", "pixels", "out",
                   "no_cache", "clock_mhz")
"""Arguments of `msv2 perf` on which neither the request nor the plan of its effects depends; the rest describes the frame."""

_requests, _plans, _traces = Recent[Any](2), Recent[Any](64), Recent[Any](TRACES_KEPT)


@cache
def _state() -> str:
    """A hash of everything but the point itself on which a result rests: sources of model and tables, and the tables."""
    tables = [path.read_bytes() for path in (REPORT, CULLING_REPORT, SYNTHESIS_REPORT, TABLE) if path.is_file()]
    return fingerprint(sources_of("msv2.sweep.measure"), tables)


def point_key(point: Point) -> str:
    """The name under which a point's result is kept: a hash of the resolved request, of its files and of what computes it."""
    args, asked = point.checked()
    values = {name: str(value) for name, value in vars(args).items() if name not in ("sets", "config", "out", "no_cache")}
    files = [(str(path), path.stat().st_size, path.stat().st_mtime_ns)
             for path in map(Path, (args.scene, args.camera)) if path.exists()]
    text = json.dumps([_state(), sorted(values.items()), config_record(asked.config), point.clock_mhz, files])
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def pixels_key(point: Point) -> str:
    """The same for all points that share a golden frame, as far as can be told without the scene."""
    args, asked = point.checked()
    return trace_key(args, asked.config)


@cache
def _table() -> Table:
    return load_table()


def tried(point: Point) -> dict[str, object]:
    """The result of `measure`, or `error` and why there is none."""
    try:
        return measure(point)
    except (InputError, ValueError, RuntimeError) as failure:  # a point that cannot be measured must not end the others
        return {"error": str(failure) or type(failure).__name__}


def measure(point: Point) -> dict[str, object]:
    """Cycles, area and energy of a point.

    Returns:
        cycles, milliseconds, frames_per_s: of the frame, at the point's clock.
        geometry_cycles, render_cycles, intersections, operations: by phase, and the work.
        read_bytes, written_bytes: of memory. array_utilisation: the share of rendering in which the array has work.
        mm2, logic_mm2, memory_mm2: area at 16 nm. area_basis: "synthesised" or "estimate"; area_build: of or from which build.
        chip_mj, dram_mj, wires_mj: energies of the frame; the last are assumptions. energy_basis: as area_basis.

    Raises:
        InputError: the request is not valid.
    """
    args, asked = point.checked()
    request, plan = _prepared(args, asked)
    trace, machine = _traced(args, asked, request, plan)
    cycles = simulated(trace, machine, asked)
    built = asked.config.with_(stereo=args.stereo) if asked.options.full else machine
    energy = modelled_energy(trace, cycles, built, _table(), clock_hz=1e6 * point.clock_mhz)
    area = estimate_area(built)
    return {
        "cycles": cycles.total, "milliseconds": cycles.total / point.clock_mhz / 1e3,
        "frames_per_s": 1e6 * point.clock_mhz / cycles.total, "geometry_cycles": cycles.phases["geometry"],
        "render_cycles": cycles.phases["render"], "intersections": cycles.entries, "operations": cycles.ops,
        "read_bytes": cycles.dram_bytes["read"], "written_bytes": cycles.dram_bytes["write"],
        "array_utilisation": cycles.utilisation["array"], "mm2": area.mm2, "logic_mm2": area.logic_mm2,
        "memory_mm2": area.memory_mm2, "area_basis": area.basis, "area_build": area.build, "chip_mj": energy.chip_mj,
        "dram_mj": energy.sum_mj("dram"), "wires_mj": energy.sum_mj("assumed"), "energy_basis": _energy_basis(built),
        "configuration": config_record(built)}


def _prepared(args: argparse.Namespace, asked: Asked) -> tuple[Request, EffectPlan]:
    """The request and the plan of its effects."""
    asks = {name: str(value) for name, value in vars(args).items() if name not in _OF_THE_MACHINE}
    frame = tuple(sorted(asks.items()))
    request = _requests.get(frame, lambda: resolve(args))
    contention = asked.memory.bytes_per_cycle is not None

    def plan() -> EffectPlan:
        with contextlib.redirect_stdout(io.StringIO()):  # it prints what it finds, which is the same for hundreds of points
            return plan_for(args, request, asked.config, contention=contention)

    return request, _plans.get((frame, contention), plan)


def _traced(
    args: argparse.Namespace, asked: Asked, request: Request, plan: EffectPlan,
) -> tuple[Trace, AcceleratorConfig]:
    machine = planned_machine(plan, asked.config, full=asked.options.full)
    trace = _traces.get(trace_key(args, machine), lambda: traced(args, asked, request, plan, CACHE)[0])
    return trace, machine


def _energy_basis(config: AcceleratorConfig) -> str:
    """Whether the netlists whose energy was measured are this machine's own."""
    same = all(getattr(config, f.name) == getattr(PAPER, f.name) for f in fields(config) if f.name not in NO_AREA)
    return SYNTHESISED if same else ESTIMATE
