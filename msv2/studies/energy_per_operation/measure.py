"""Measures the energies of units at work: simulates them, compares their outputs, and adds up."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from golden.msv2_ref.pipeline import Frame
from msv2.studies.energy_per_operation import gates
from msv2.studies.energy_per_operation.netlists import Mapped, map_unit
from msv2.studies.energy_per_operation.super_work import SUPER_WORK
from msv2.studies.energy_per_operation.work import WORK, Work
from rtl.units import UNITS
from spec.config import AcceleratorConfig
from synth.power.energy import by_part, total
from synth.power.netlist import Flat
from synth.power.simulate import Counts
from tb.supertiles.batch_suite import cleared
from tb.vrc_array.array_check import golden_pixels, mismatches
from tb.vrc_array.array_device import tiles_from_rows
from tb.vrc_array.array_stimuli import Case

FEMTO_TO_PICO = 1e-3
PICO_TO_MILLI = 1e-9

IDLE = 50
"""Number of idle cycles after a reset in which a unit without work is observed."""


class Unequal(RuntimeError):
    """A netlist's outputs are wrong, so that its activity is no measurement."""


def map_work(unit: str, config: AcceleratorConfig, clock_ps: float, folder: Path) -> Mapped:
    """The mapped netlist of a unit."""
    return map_unit(UNITS[unit].make(config), unit, clock_ps, folder)


def measure(mapped: Mapped, unit: str, config: AcceleratorConfig, scene: str, frame: Frame) -> dict[str, object]:
    """A unit's row: the energy of an operation, the clock energy of a cycle, and leakage. Raises Unequal where a bit is
    wrong."""
    work = (WORK | SUPER_WORK)[unit](config, scene, frame)
    simulation = mapped.simulation()
    gates.start(simulation, work.playback, work.plan.run, work.constants, work.strobe)
    played = gates.play(
        simulation, work.playback, work.plan.run, work.window, answers=work.answers, counters=work.counters)
    compared = sum(len(rows) for rows in played.outputs.values())
    wrong = _problems(config, work, played)
    if wrong:
        raise Unequal(f"{unit}, {scene}: " + "; ".join(wrong))
    if not compared:
        raise ValueError(f"{unit}, {scene}: outputs must come before the run is left")
    operations = work.count(played.moved)
    if operations <= 0:
        raise ValueError(f"{unit}, {scene}: the window must have operations, not {played.moved!r}")
    return {
        "unit": unit, "scene": scene, "operation": work.operation, "operations": operations,
        "cycles": played.counts.cycles, "items_compared": compared, "area_um2": round(mapped.area_um2, 1),
        **_energies(mapped, played.counts, operations), "memories": _accesses(mapped.flat, played.counts, operations)}


def _problems(config: AcceleratorConfig, work: Work, played: gates.Played) -> list[str]:
    if work.unit in ("batch_buffer", "stream_buffer"):  # the rest of an item that ends a visit means nothing
        played = replace(played, outputs={
            port: cleared(rows) if port.startswith("entries") else rows for port, rows in played.outputs.items()})
    if work.unit != "vrc_array":
        return gates.problems(work.plan.expected, played, whole=work.window.whole)
    run = work.plan.run  # the array may give the rows of a tile in any order
    case = Case(run.name, run.inputs["tiles"], run.inputs["entries"], _background(config, run.settings["background"]))
    pixels = tiles_from_rows(config, case.headers, played.outputs["pixels"])
    return [*played.errors, *map(str, mismatches(pixels, golden_pixels(config, case))[:3])]


def _background(config: AcceleratorConfig, bits: int) -> np.ndarray:
    width = config.formats.colour.width
    return np.array([bits >> width * channel & (1 << width) - 1 for channel in range(3)])


def _energies(mapped: Mapped, counts: Counts, operations: int) -> dict[str, object]:
    parts = by_part(mapped.flat, mapped.electrical, counts)
    everything, cycles = total(parts), counts.cycles

    def row(energies) -> dict[str, float]:
        return {
            "pj_per_operation": round(energies.dynamic * FEMTO_TO_PICO / operations, 5),
            **{f"{kind}_pj_per_operation": round(getattr(energies, kind) * FEMTO_TO_PICO / operations, 5)
               for kind in ("internal", "switching", "registers", "gated")},
            "clock_pj_per_cycle": round(energies.clock * FEMTO_TO_PICO / cycles, 5),
            "leakage_mw": round(energies.leakage * PICO_TO_MILLI, 6)}

    return row(everything) | {"parts": {name: row(part) for name, part in parts.items() if len(parts) > 1 and part.leakage}}


def _accesses(flat: Flat, counts: Counts, operations: int) -> list[dict[str, float]]:
    return [
        {"words": memory.words, "width": memory.width, "reads_per_operation": round(float(reads) / operations, 5),
         "writes_per_operation": round(float(writes) / operations, 5)}
        for memory, (reads, writes) in zip(flat.memories, counts.accesses, strict=True)]


def still(mapped: Mapped, unit: str) -> dict[str, object]:
    """A unit's row without work: clock energy and leakage of its netlist after a reset, and its remaining activity then."""
    simulation = mapped.simulation()
    simulation.timed = False
    for name in mapped.flat.inputs:
        if name != "clk":
            simulation.set(name, int(name == "rst"))
    for cycle in range(gates.RESET + IDLE):
        if cycle == gates.RESET:
            simulation.set("rst", 0)
            simulation.forget()
        simulation.settle()
        simulation.edge()
    energies = _energies(mapped, simulation.counts(), IDLE)
    return {"unit": unit, "area_um2": round(mapped.area_um2, 1), "clock_pj_per_cycle": energies["clock_pj_per_cycle"],
            "leakage_mw": energies["leakage_mw"], "idle_pj_per_cycle": energies["pj_per_operation"],
            "gates": len(mapped.flat.gate_output), "flip_flops": len(mapped.flat.flop_data),
            "memories": [{"words": m.words, "width": m.width} for m in mapped.flat.memories]}
