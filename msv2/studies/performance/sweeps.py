"""Sweeps in which one resource or setting changes at a time, and comparisons of both machines over area."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from msv2.studies.performance.area import GSCORE_MM2_16NM, machine_mm2
from msv2.studies.performance.frames import Compared
from msv2.studies.performance.machines import BANDWIDTHS, BASE, BOTH, GSCORE, UNLIMITED_BYTES, Run, run_gscore, run_ours
from perf.gscore import GscoreConfig, gscore_cycles
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
SCALED = ((4, 4, 1), (8, 8, 2), (16, 8, 4), (16, 16, 8))
"""Cores and culling units of our machine in a fixed ratio, up to the paper's. The array cannot be larger than a tile."""

COMPARED_MM2 = 6.0
"""The area at which the paper compares both machines."""

FACTORS = (0.125, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0)
"""Multiples of the published GSCore's units."""


def _row(frame: Compared, sweep: str, value: object, run: Run) -> dict[str, object]:
    return {"frame": frame.name, "sweep": sweep, "value": value, "bytes_per_cycle": run.bytes_per_cycle, "cycles": run.cycles,
            "geometry": run.geometry, "render": run.render, "chip_mj": run.chip_mj, "dram_bytes": run.dram_bytes}


def sweeps(frame: Compared) -> list[dict[str, object]]:
    """The rows of every sweep on a frame, with the full machine; the sweeps of beta are made with both kinds of handover."""
    def ours(config: AcceleratorConfig, bandwidth: float | None, **settings: object) -> Run:
        return run_ours(BOTH.name, [frame.frame], config, bandwidth, **{"merge": True} | settings)[0]

    out = []
    for bandwidth in BANDWIDTHS:
        for pipeline in (True, False):
            for beta in BETAS:
                run = ours(PAPER.with_(incremental=pipeline), bandwidth, beta=beta)
                out.append(_row(frame, "beta, line buffers" if pipeline else "beta, double buffers", beta, run))
        for size in LINE_BUFFERS:
            out.append(_row(frame, "line buffer, bytes", size, ours(PAPER.with_(line_buffer_bytes=size), bandwidth)))
        for size in SORT_BUFFERS:
            out.append(_row(frame, "sort buffer, bytes", size, ours(PAPER.with_(sort_buffer_bytes=size), bandwidth)))
        for units in CULLING_UNITS:
            out.append(_row(frame, "culling units", units, ours(PAPER.with_(culling_units=units), bandwidth)))
        for x, y in CORES:
            out.append(_row(frame, "cores", x * y, ours(PAPER.with_(cores_x=x, cores_y=y), bandwidth)))
    return out


def bandwidth_rows(frame: Compared) -> list[dict[str, object]]:
    """Cycles and bytes of the base machine, the full machine and GSCore, by memory bandwidth."""
    out = []
    for bandwidth in BYTES_PER_CYCLE:
        for m in (BASE, BOTH):
            run = run_ours(m.name, [frame.frame], PAPER.with_(incremental=m.pipeline), bandwidth, merge=m.merge)[0]
            out.append(_row(frame, m.name, bandwidth, run))
        out.append(_row(frame, GSCORE, bandwidth, run_gscore(frame, bandwidth)))
    return out


def iso_area(frame: Compared, area: Mapping[str, object] | None) -> list[dict[str, object]]:
    """Frames per second of both machines over mm^2 at 16 nm; empty without an area report."""
    if area is None:
        return []
    out = []
    for bandwidth in BANDWIDTHS:
        for x, y, units in SCALED:
            config = PAPER.with_(cores_x=x, cores_y=y, culling_units=units)
            run = run_ours(BOTH.name, [frame.frame], config, bandwidth, merge=True)[0]
            out.append({"frame": frame.name, "machine": BOTH.name, "scaled": f"{x * y} cores, {units} culling units",
                        "mm2_16nm": machine_mm2(area, config), "bytes_per_cycle": bandwidth, "cycles": run.cycles,
                        "frames_per_s": run.frames_per_s})
        for factor in FACTORS:
            run = run_gscore(frame, bandwidth, factor)
            out.append({"frame": frame.name, "machine": GSCORE, "scaled": f"{factor:g} times", "cycles": run.cycles,
                        "mm2_16nm": factor * GSCORE_MM2_16NM, "bytes_per_cycle": bandwidth, "frames_per_s": run.frames_per_s})
    return out


def at_equal_area(frame: Compared, ours: Iterable[Run], area: Mapping[str, object] | None) -> list[dict[str, object]]:
    """Our full machine against GSCore scaled to the same area, and to the paper's 6 mm²: speedups of frame and rendering
    phase."""
    if area is None:
        return []
    mm2, out = machine_mm2(area, PAPER), []
    for run in ours:
        published = GscoreConfig(bytes_per_cycle=run.bytes_per_cycle or UNLIMITED_BYTES)
        other = gscore_cycles(frame.gscore, published.scaled(mm2 / GSCORE_MM2_16NM))
        large = gscore_cycles(frame.gscore, published.scaled(COMPARED_MM2 / GSCORE_MM2_16NM))
        out.append({"frame": frame.name, "mm2_16nm": mm2, "factor": mm2 / GSCORE_MM2_16NM,
                    "bytes_per_cycle": run.bytes_per_cycle, "ours_cycles": run.cycles,
                    "gscore_cycles": other.total, "speedup": other.total / run.cycles,
                    "speedup_render": other.render / run.render, "speedup_over_large": large.total / run.cycles,
                    "large_mm2_16nm": COMPARED_MM2, "ours_dram_bytes": run.dram_bytes,
                    "gscore_dram_bytes": other.dram_bytes})
    return out
