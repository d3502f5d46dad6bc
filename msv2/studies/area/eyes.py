"""`msv2 study run area_eyes`: area and timing of what joint frames of two eyes add to the units of `v3`: area_eyes.{json,md}.

The units that only machines with joint frames have are synthesised alone, and the others with and without the field `joint`,
for 1 ns in ASAP7. Where reports/synthesis.json has a unit of `v3`, that is the one without. The machine's
area follows: that of one eye, what the units add, and the macros of its memories (`msv2.studies.area.estimate`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from amaranth.lib import wiring

from golden.scenes.files import read_json
from msv2.studies.area.estimate import REPORT_OF_EYES, estimate_area
from msv2.studies.page import table, write_page
from msv2.studies.progress import Progress
from msv2.studies.record import liberties, write_report
from rtl.culling.eyes import EyeCulls, EyePoints
from rtl.supertiles.pair_union import PairUnion
from rtl.units import UNITS
from spec.command_line import command_parser
from spec.config import V3, V3_EYES, V3_EYES_STREAMS, V3_STREAMS, AcceleratorConfig
from spec.errors import run_command_line
from spec.paths import REPORTS, ROOT
from synth.machine import BLENDING, CULLING, LISTS
from synth.report import Settings, synthesise

CLOCK_PS = 1000.0

GOAL_MM2 = 1.65
"""The goal for two eyes with super-tiles of 8 by 2 tiles, at 16 nm."""

Maker = Callable[[AcceleratorConfig], wiring.Component]


class Part(NamedTuple):
    """A unit of machines with joint frames.

    Attributes:
        group: the group of the area report in which it counts.
        make: its maker; None for the unit of this name in `rtl.units`.
        alone: whether machines without joint frames have it, too.
    """

    group: str
    make: Maker | None = None
    alone: bool = True


PARTS: dict[str, Part] = {
    "eye_points": Part(CULLING, EyePoints, alone=False),
    "eye_culls": Part(CULLING, EyeCulls, alone=False),
    "pair_union": Part(CULLING, PairUnion, alone=False),
    "level_bounds": Part(CULLING),
    "supertile_clip": Part(CULLING),
    "supertile_reader": Part(LISTS),
    "pixel_writer": Part(LISTS),
    "batch_buffer": Part(BLENDING),
    "chunk_test": Part(CULLING),
    "near_test": Part(CULLING),
}
"""The units, small ones first. A machine with joint frames has `level_bounds` twice."""

UNMEASURED = ("projection", "supertile_test", "pair_colour", "stream_buffer", "stream_arrays")
"""Units that joint frames change, too, and that are not synthesised with them: what they add is in no sum."""


def measured(name: str, config: AcceleratorConfig) -> dict[str, Any]:
    """Area in um^2, slack at CLOCK_PS and bits of memory of a unit in ASAP7."""
    make = PARTS[name].make or UNITS[name].make
    found = synthesise(make(config), name, Settings("asap7", CLOCK_PS, ROOT / "build" / "results" / "synth"))
    return {key: found[key] for key in ("area_um2", "slack_ps", "memory_bits")}


def row_of(name: str, known: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """The numbers of a unit; `known` are the rows of reports/synthesis.json."""
    part = PARTS[name]
    row: dict[str, Any] = {"unit": name, "group": part.group, **measured(name, V3_EYES)}
    if not part.alone:
        return {**row, "added_um2": row["area_um2"]}
    stored = known.get(name)
    old = stored if stored and stored["config"] == V3.name else measured(name, V3)
    count = 2 if name == "level_bounds" else 1
    return {**row, "count": count, "alone_um2": old["area_um2"], "alone_slack_ps": old["slack_ps"],
            "added_um2": round(count * row["area_um2"] - old["area_um2"], 2)}


def machines(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The areas of the machines of two eyes, from the rows of the units."""
    found = []
    for config, one in ((V3_EYES, V3), (V3_EYES.with_(batch_places=1024), V3), (V3_EYES_STREAMS, V3_STREAMS.with_(packed=True)),
                        (V3_EYES_STREAMS.with_(batch_places=1024), V3_STREAMS.with_(packed=True))):
        both, single = estimate_area(config, rows), estimate_area(one)
        found.append({"machine": config.name, "batch_places": config.batch_places, "mm2": round(both.mm2, 4),
                      "logic_mm2": round(both.logic_mm2, 4), "memory_mm2": round(both.memory_mm2, 4),
                      "one_eye_mm2": round(single.mm2, 4)})
    return found


def page(content: Mapping[str, Any]) -> str:
    """The report as a Markdown page."""
    units = [
        (f"`{r['unit']}`", f"{r['area_um2']:,.0f}", f"{r['slack_ps']:.0f}",
         f"{r['alone_um2']:,.0f}" if "alone_um2" in r else "-",
         f"{r['added_um2']:,.0f}", f"{r['memory_bits']:,}",
         "yes" if r["slack_ps"] >= 0 else "NO") for r in content["rows"]]
    sums = [
        (f"`{m['machine']}`", f"{m['batch_places']:,}", *(f"{m[name]:.3f}" for name in (
            "mm2", "logic_mm2", "memory_mm2", "one_eye_mm2"))) for m in content["machines"]]
    return "\n\n".join([
        "# Area of two eyes in one list",
        "Written by `msv2 study run area_eyes`. Joint frames ([docs/stereo.md](../docs/stereo.md#joint-frames)) add units to "
        "the machine and make others larger. Each was synthesised alone in ASAP7 for 1 ns, without wires, as "
        "[area.md](area.md) has it.",
        "## Units",
        table(("unit", "with joint frames, um²", "slack, ps", "without, um²", "added, um²", "bits of memory", "meets 1 ns"),
              units, 1),
        "A machine has `level_bounds` twice. Joint frames change these units as well, which are not synthesised with them, so "
        f"that no sum has what they add, and their timing is not known: {', '.join(f'`{name}`' for name in UNMEASURED)}. The "
        "batch buffer of four arrays is taken to grow as much as that of one.",
        "## Machines",
        f"Areas at 16 nm, memories included, row width {V3_EYES.row_width:,}. The machine of one eye, with as many arrays and "
        f"with packed frames where the other has them, stands beside. The goal for two eyes is {GOAL_MM2} mm².",
        table(("machine", "places of a batch", "mm²", "logic", "memories", "one eye"), sums, 1)])


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line."""
    command_parser("msv2 study run area_eyes", __doc__).parse_args(argv)
    known = {row["unit"]: row for row in read_json(REPORTS / "synthesis.json")["rows"]}
    progress, rows = Progress("area_eyes", list(PARTS)), []
    for name in PARTS:
        with progress.step(name):
            rows.append(row_of(name, known))
    content = {"clock_ps": CLOCK_PS, "goal_mm2": GOAL_MM2, "rows": rows, "machines": machines(rows)}
    write_report(REPORT_OF_EYES, content, [__name__], {c.name: c for c in (V3_EYES, V3_EYES_STREAMS)}, liberties())
    write_page(REPORT_OF_EYES.with_suffix(".md"), page(content))
    return 0


if __name__ == "__main__":
    run_command_line(main)
