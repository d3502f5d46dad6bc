"""Sweeps in which one resource or setting changes at a time, and comparisons of both machines over area."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from msv2.studies.memory import IDEAL, LPDDR3, UNLIMITED
from msv2.studies.performance.area import GSCORE_MM2_16NM, machine_mm2
from msv2.studies.performance.frames import Compared
from msv2.studies.performance.machines import (
    BASE,
    BOTH,
    GSCORE,
    MEMORIES,
    PEAK,
    UNLIMITED_BYTES,
    Run,
    rate_for_gscore,
    run_gscore,
    run_ours,
)
from perf.gscore import GscoreConfig, GscoreCycles, gscore_cycles
from spec.config import PAPER, AcceleratorConfig

BETAS = (0, 32, 64, 128, 256, 512, 1024, 2048, 4096, None)
"""Merge thresholds in intersections; 0 merges nothing, None stands for the automatic threshold."""

LINE_BUFFERS = (64, 128, 256, 512, 1024, 2048, 4096)
"""Sizes of the line buffer in bytes."""

SORT_BUFFERS = (4096, 16384, 65536)
"""Sizes in bytes of the double buffer before the sorter. The largest chunk fits half of it."""

CULLING_UNITS = (1, 2, 4, 8)
CORES = ((4, 4), (8, 4), (8, 8), (16, 8), (16, 16))
BYTES_PER_CYCLE = (6.4, 12.8, 25.6, 38.4, 51.2, None)
"""Bandwidths of the ideal memory, beside which LPDDR3 is shown at its own."""

SCALED = ((4, 4, 1), (8, 8, 2), (16, 8, 4), (16, 16, 8))
"""Cores and culling units of our machine in a fixed ratio, up to the paper's. The array cannot be larger than a tile."""

COMPARED_MM2 = 6.0
"""The area at which the paper compares both machines."""

FACTORS = (0.125, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0)
"""Multiples of the published GSCore's units."""


def _row(frame: Compared, sweep: str, value: object, run: Run) -> dict[str, object]:
    return {"frame": frame.name, "sweep": sweep, "value": value, "memory": run.memory, "bytes_per_cycle": run.bytes_per_cycle,
            "cycles": run.cycles, "geometry": run.geometry, "render": run.render, "chip_mj": run.chip_mj,
            "dram_bytes": run.dram_bytes}


def sweeps(frame: Compared) -> list[dict[str, object]]:
    """The rows of every sweep on a frame, with the full machine; the sweeps of beta are made with both kinds of handover."""
    def ours(config: AcceleratorConfig, memory: str, **settings: object) -> Run:
        return run_ours(BOTH.name, [frame.frame], config, memory, **{"merge": True} | settings)[0]

    out = []
    for memory in MEMORIES:
        for pipeline in (True, False):
            for beta in BETAS:
                run = ours(PAPER.with_(incremental=pipeline), memory, beta=beta)
                out.append(_row(frame, "beta, line buffers" if pipeline else "beta, double buffers", beta, run))
        for size in LINE_BUFFERS:
            out.append(_row(frame, "line buffer, bytes", size, ours(PAPER.with_(line_buffer_bytes=size), memory)))
        for size in SORT_BUFFERS:
            out.append(_row(frame, "sort buffer, bytes", size, ours(PAPER.with_(sort_buffer_bytes=size), memory)))
        for units in CULLING_UNITS:
            out.append(_row(frame, "culling units", units, ours(PAPER.with_(culling_units=units), memory)))
        for x, y in CORES:
            out.append(_row(frame, "cores", x * y, ours(PAPER.with_(cores_x=x, cores_y=y), memory)))
    return out


def bandwidth_rows(frame: Compared) -> list[dict[str, object]]:
    """Cycles and bytes of the base machine, the full machine and GSCore: with LPDDR3, and by the ideal memory's bandwidth."""
    out = []
    for bandwidth in (LPDDR3, *BYTES_PER_CYCLE):
        memory = LPDDR3 if bandwidth == LPDDR3 else IDEAL if bandwidth else UNLIMITED
        given = bandwidth if memory == IDEAL else None
        for m in (BASE, BOTH):
            run = run_ours(m.name, [frame.frame], m.config, memory, merge=m.merge, bandwidth=given)[0]
            out.append(_row(frame, m.name, run.bytes_per_cycle, run))
        other = run_gscore(frame, memory, rate=given or rate_for_gscore(run))
        out.append(_row(frame, GSCORE, run.bytes_per_cycle, other))
    return out


def iso_area(frame: Compared, area: Mapping[str, object] | None) -> list[dict[str, object]]:
    """Frames per second of both machines over mm^2 at 16 nm; empty without an area report."""
    if area is None:
        return []
    out = []
    for memory in MEMORIES:
        for x, y, units in SCALED:
            config = PAPER.with_(cores_x=x, cores_y=y, culling_units=units)
            run = run_ours(BOTH.name, [frame.frame], config, memory, merge=True)[0]
            out.append({"frame": frame.name, "machine": BOTH.name, "scaled": f"{x * y} cores, {units} culling units",
                        "mm2_16nm": machine_mm2(area, config), "memory": memory, "cycles": run.cycles,
                        "frames_per_s": run.frames_per_s})
        rate = rate_for_gscore(run)  # of our largest machine, the paper's
        for factor in FACTORS:
            run = run_gscore(frame, memory, factor, rate=rate)
            out.append({"frame": frame.name, "machine": GSCORE, "scaled": f"{factor:g} times", "cycles": run.cycles,
                        "mm2_16nm": factor * GSCORE_MM2_16NM, "memory": memory, "frames_per_s": run.frames_per_s})
    return out


def at_equal_area(frame: Compared, ours: Iterable[Run], mm2: float | None) -> list[dict[str, object]]:
    """One of our machines against GSCore scaled to the same area, and to the paper's 6 mm²: speedups of frame and rendering
    phase. Empty where its area is not known.

    With LPDDR3, GSCore gets the bytes in a cycle that ours gets (`run_gscore`). `speedup_bound` is the speedup if it got all
    bytes that the memory's wires can move; with the other memories both are the same.
    """
    if mm2 is None:
        return []
    out = []
    for run in ours:
        def cycles(square_mm: float, rate: float | None, of: Run = run) -> GscoreCycles:
            config = GscoreConfig(bytes_per_cycle=rate or PEAK[of.memory] or UNLIMITED_BYTES)
            return gscore_cycles(frame.gscore, config.scaled(square_mm / GSCORE_MM2_16NM))

        rate = rate_for_gscore(run)
        other, large, bound = cycles(mm2, rate), cycles(COMPARED_MM2, rate), cycles(mm2, None)
        out.append({"frame": frame.name, "mm2_16nm": mm2, "factor": mm2 / GSCORE_MM2_16NM, "memory": run.memory,
                    "gscore_bytes_per_cycle": rate, "ours_cycles": run.cycles, "gscore_cycles": other.total,
                    "speedup": other.total / run.cycles, "speedup_render": other.render / run.render,
                    "speedup_bound": bound.total / run.cycles, "speedup_over_large": large.total / run.cycles,
                    "large_mm2_16nm": COMPARED_MM2, "ours_dram_bytes": run.dram_bytes,
                    "gscore_dram_bytes": other.dram_bytes})
    return out
