"""Area of culling at a fixed throughput, by the number of units that share the work: reports/culling_area.json and the table in
docs/synthesis.md.

    msv2 study run culling_area            generic gates; with MSV2_PDK in ASAP7 as well (minutes)

All variants take a point per cycle through near test and projection, and a visible splat every four cycles through the colour
unit. They do so with one unit whose operators make one operation each, or with several units whose operators are shared by a
schedule. Every unit is synthesised as a whole; each kind of operator is synthesised once, and the areas are added up.

Every memory, however small, is left out and counted in bits. Otherwise many small queues would be made of flip-flops where one
large queue is a macro, and this difference is not what is compared.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from amaranth.lib import wiring

from msv2.studies import page, record
from msv2.studies.destination import newest
from msv2.studies.record import write_report
from rtl.culling.colour import ColourUnit, splat_interval
from rtl.culling.compare import unit_cost
from rtl.culling.harmonics import harmonics_graph
from rtl.culling.projection_unit import ProjectionUnit
from rtl.culling.schedule import Cost, cost, schedule
from spec.command_line import command_parser
from spec.config import PAPER, AcceleratorConfig
from spec.errors import run_command_line
from spec.harmonics import terms
from spec.paths import DOCS, REPORTS, ROOT
from synth.liberty import PDK_VARIABLE
from synth.report import Settings, synthesise

PAGE, REPORT = DOCS / "synthesis.md", REPORTS / "culling_area.json"

CLOCK_PS = 1000.0
SH_DEGREE = 3


@dataclass(frozen=True)
class Part:
    """A unit that is compared.

    Attributes:
        make: makes the unit for a configuration.
        interval: the cycles that one unit takes per item.
        counts: the counts of one unit's schedule.
        sums: the products per cycle that one unit makes outside its datapath.
        throughput: the throughput of all units together, in words.
    """

    make: Callable[[AcceleratorConfig], wiring.Component]
    interval: Callable[[AcceleratorConfig], int]
    counts: Callable[[AcceleratorConfig], Cost]
    sums: Callable[[AcceleratorConfig], int]
    throughput: str


def _colour_counts(config: AcceleratorConfig) -> Cost:
    return cost(schedule(harmonics_graph(config, SH_DEGREE), splat_interval(config)))


PARTS = {
    "projection_unit": Part(
        ProjectionUnit, lambda c: c.point_interval, lambda c: unit_cost(c, c.point_interval), lambda c: 0, "a point a cycle"),
    "colour_unit": Part(
        ColourUnit, splat_interval, _colour_counts, lambda c: 3 * -(-terms(SH_DEGREE) // splat_interval(c)),
        "a splat every 4 cycles"),
}
"""The compared units, by name."""


def machines(config: AcceleratorConfig) -> list[AcceleratorConfig]:
    """Configurations of one unit with the whole machine's throughput, and with a half, a quarter and an eighth of it."""
    return [config.with_(culling_units=config.culling_units // share) for share in (1, 2, 4, 8)]


def measure(folder: Path, config: AcceleratorConfig = PAPER) -> list[dict[str, object]]:
    """The rows of the report. Areas in um^2 and slacks are null without liberty files. `folder` keeps netlists and results."""
    rows = []
    for name, part in PARTS.items():
        fastest = part.interval(config)
        for machine in machines(config):
            units, counts = part.interval(machine) // fastest, part.counts(machine)
            gates = synthesise(part.make(machine), name, Settings("generic", CLOCK_PS, folder, memory_limit=0))
            cells = dict.fromkeys(("area_um2", "slack_ps"))
            if os.environ.get(PDK_VARIABLE):
                cells = synthesise(part.make(machine), name, Settings("asap7", CLOCK_PS, folder, memory_limit=0))
            operators = sum(below["count"] for below in gates["modules_below"].values())
            rows.append({
                "part": name, "throughput": part.throughput, "units": units, "interval": part.interval(machine),
                "operators": units * (operators + part.sums(machine)),
                "register_bits": units * counts.register_bits, "mux_bits": units * counts.mux_bits,
                "flip_flops": units * gates["flip_flops"], "memory_bits": units * gates["memory_bits"],
                "nand2_equivalents": units * gates["nand2_equivalents"],
                "nand2_without_operators": units * gates["without_modules_below"],
                "area_um2": None if cells["area_um2"] is None else round(units * cells["area_um2"], 1),
                "slack_ps": cells["slack_ps"], "clock_ps": CLOCK_PS})
            print(rows[-1], flush=True)
    return rows


def table(rows: list[dict[str, object]]) -> str:
    """The report's table in Markdown."""
    head = ["units", "cycles each", "operators", "register bits", "2:1 mux bits", "flip-flops", "memory bits", "NAND2",
            "of that outside operators", "um² ASAP7", "slack, ps"]
    keys = ["units", "interval", "operators", "register_bits", "mux_bits", "flip_flops", "memory_bits", "nand2_equivalents",
            "nand2_without_operators", "area_um2", "slack_ps"]
    parts = []
    for part in dict.fromkeys(row["part"] for row in rows):
        of_part = [row for row in rows if row["part"] == part]
        cells = [["-" if row[key] is None else f"{row[key]:,.0f}" for key in keys] for row in of_part]
        parts.append(f"`{part}`, {of_part[0]['throughput']}:\n\n{page.table(head, cells, left=0)}")
    return "\n\n".join(parts) or page.ABSENT


def fill(path: Path, report: Path, *, check: bool = False) -> int:
    """Writes the table into a page, between `<!-- table:culling_area -->` and `<!-- end -->`. With `check` it changes nothing
    and returns 1 where the page would change."""
    rows = json.loads(report.read_text())["rows"]
    return page.fill(path, {"culling_area": lambda: table(rows)}, check=check, complete=True)


def main(argv: Sequence[str] | None = None) -> int:
    """Measures, writes the report and fills the page."""
    command_parser("msv2 study run culling_area", __doc__).parse_args(argv)
    rows = measure(ROOT / "build" / "results" / "synth")
    write_report(REPORT, {"config": PAPER.name, "rows": rows}, [__name__], {"config": PAPER}, record.liberties())
    return fill(PAGE, newest(REPORT))


if __name__ == "__main__":
    run_command_line(main)
