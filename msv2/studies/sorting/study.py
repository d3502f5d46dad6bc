"""How fast scenes' frames are sorted, and what of them waits in memory: reports/sorting.json.

    python -m msv2.studies sorting          scenes in MSV2_DATA (minutes)

The sorter of the paper's machine alone, from Verilog, every entry compared: its groups come as fast as it takes them, what it
gives is taken at once, and its memory answers after `LATENCY` cycles. The README's table is made of it by
msv2/studies/results/tables.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from spec.config import PAPER, AcceleratorConfig
from spec.paths import ROOT
from synth.report import write_json
from tb.common.exact import Outcome, Planned, rate
from tb.common.runner import SimulationError
from tb.common.scenes import TRAINED, scene_path
from tb.sort_tmu.hierarchical_suite import LATENCY, run_plan, traced_plan

REPORT = ROOT / "reports" / "sorting.json"

SIZES = ("256x144", "640x360")
"""Of the frames; each without a gaze and with one."""


def group_lengths(items: np.ndarray) -> np.ndarray:
    """(groups,) entries of each group of ChunkEntry items."""
    ends = np.flatnonzero(items["last"])
    counted = np.concatenate(([0], np.cumsum(items["empty"] == 0)))
    return np.diff(counted[ends + 1], prepend=0)


def row_of(config: AcceleratorConfig, item: Planned, outcome: Outcome) -> dict[str, object]:
    """A frame's numbers: `taken_per_cycle` is of the cycles in which an entry was offered."""
    recording, lengths = outcome.recordings[item.name], group_lengths(item.run.inputs["groups"])
    large = lengths[lengths > config.sort_chunk]
    return {
        "frame": item.name.removeprefix("traced "), "entries": int(lengths.sum()), "groups": len(lengths),
        "large_groups": len(large), "entries_in_large_groups": int(large.sum()),
        "entries_written": recording.observed["spilled"], "taken_per_cycle": round(rate(recording, "groups"), 4),
        "cycles": recording.cycles}


def measure(config: AcceleratorConfig, sizes: tuple[str, ...], folder: Path) -> dict[str, object]:
    """The report. Raises SimulationError where an entry is wrong."""
    rows = []
    for size in sizes:
        plan = traced_plan(config, size)
        outcome = run_plan(config, plan, folder / f"sorting-{size}", progress=True)
        if outcome.failures:
            raise SimulationError(f"the sorter is wrong: {outcome.failures}")
        rows += [row_of(config, item, outcome) for item in plan]
    return {"config": config.name, "buffer_entries": config.sort_chunk, "latency": LATENCY, "rows": rows}


def main(argv: Sequence[str] | None = None) -> int:
    """The command line's work."""
    for scene in TRAINED:
        if scene_path(scene) is None:
            print(f"skipped: {scene} (no such scene in MSV2_DATA)")
    write_json(REPORT, measure(PAPER, SIZES, ROOT / "build" / "results"))
    return 0
