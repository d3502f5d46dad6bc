"""Measures how fast real scenes' frames are sorted, and how much of them is written to memory, for reports/sorting.json.

    msv2 study run sorting          scenes in MSV2_DATA (minutes)

The sorter of PAPER's machine is simulated alone, from Verilog, and all of its outputs are compared. It receives groups as fast
as it accepts them, its output is accepted at once, and its memory answers after `LATENCY` cycles. From the report,
msv2/studies/results/tables.py makes the table in docs/results.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from msv2.studies.record import write_report
from msv2.studies.scenes import View, available, places
from spec.command_line import command_parser
from spec.config import PAPER, AcceleratorConfig
from spec.paths import REPORTS, ROOT
from spec.private import private_folder
from tb.common.exact import Outcome, Planned, rate
from tb.common.runner import SimulationError
from tb.common.scenes import TRAINED
from tb.sort_tmu.hierarchical_suite import LATENCY, run_plan, traced_plan

REPORT = REPORTS / "sorting.json"

SIZES = ("256x144", "640x360")
"""Sizes of the frames, each rendered without a gaze and with one."""


def group_lengths(items: np.ndarray) -> np.ndarray:
    """(groups,) the number of intersections in each group of ChunkItem items."""
    ends = np.flatnonzero(items["last"])
    counted = np.concatenate(([0], np.cumsum(items["empty"] == 0)))
    return np.diff(counted[ends + 1], prepend=0)


def row_of(config: AcceleratorConfig, item: Planned, outcome: Outcome) -> dict[str, object]:
    """The numbers of a frame. `taken_per_cycle` counts only cycles in which an intersection was offered."""
    recording, lengths = outcome.recordings[item.name], group_lengths(item.run.inputs["groups"])
    large = lengths[lengths > config.sort_chunk]
    return {
        "frame": item.name.removeprefix("traced "), "entries": int(lengths.sum()), "groups": len(lengths),
        "large_groups": len(large), "entries_in_large_groups": int(large.sum()),
        "entries_written": recording.observed["spilled"], "taken_per_cycle": round(rate(recording, "groups"), 4),
        "cycles": recording.cycles}


def measure(config: AcceleratorConfig, sizes: tuple[str, ...], folder: Path) -> dict[str, object]:
    """The content of the report. Raises SimulationError where the sorter's output is wrong."""
    rows = []
    for size in sizes:
        plan = traced_plan(config, size)
        with private_folder(folder / f"sorting-{size}") as place:
            outcome = run_plan(config, plan, place, progress=True)
        if outcome.failures:
            raise SimulationError(f"the sorter is wrong: {outcome.failures}")
        rows += [row_of(config, item, outcome) for item in plan]
    return {"config": config.name, "buffer_entries": config.sort_chunk, "latency": LATENCY, "rows": rows}


def main(argv: Sequence[str] | None = None) -> int:
    """Measures all frames and writes the report."""
    command_parser("msv2 study run sorting", __doc__).parse_args(argv)
    views = [View(scene, SIZES[0]) for scene in TRAINED]
    list(available(views))  # prints the missing scenes
    report = measure(PAPER, SIZES, ROOT / "build" / "results")
    write_report(REPORT, report, [__name__], {"config": PAPER, "sizes": SIZES}, places(views))
    return 0
