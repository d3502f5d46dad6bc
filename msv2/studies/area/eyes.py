"""`msv2 study run area_eyes`: area and timing of what joint frames of two eyes, and overlapped phases, add to the units of
`v3`: area_eyes.{json,md}.

The units that only machines with such a field have are synthesised alone, and the others with and without the field, for 1 ns
in ASAP7. Where reports/synthesis.json has a unit as it is without, that one counts. The machine's area follows: that of one
eye, what the units add, and the macros of its memories (`msv2.studies.area.estimate`).

examples:
  msv2 study run area_eyes                                     every unit
  msv2 study run area_eyes --unit batch_buffer --keep          one row; the others of the report stay
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from amaranth.lib import wiring

from golden.scenes.files import read_json
from msv2.studies.area.estimate import JOINT, OVERLAP, REPORT_OF_EYES, estimate_area
from msv2.studies.destination import newest
from msv2.studies.page import table, write_page
from msv2.studies.progress import Progress
from msv2.studies.record import liberties, write_report
from rtl.culling.eyes import EyeCulls, EyePoints
from rtl.supertiles.pair_union import PairUnion
from rtl.top.list_sets import ListSets
from rtl.top.overlap_controller import OverlapController
from rtl.units import UNITS
from spec.command_line import command_parser
from spec.config import V3, V3_EYES, V3_EYES_OVERLAP, V3_EYES_STREAMS, V3_OVERLAP, V3_STREAMS, AcceleratorConfig
from spec.errors import run_command_line
from spec.paths import REPORTS, ROOT
from synth.machine import BLENDING, CONTROL, CULLING, LISTS
from synth.report import Settings, synthesise

CLOCK_PS = 1000.0

GOAL_MM2 = 1.65
"""The goal for two eyes with super-tiles of 8 by 2 tiles, at 16 nm."""

Maker = Callable[[AcceleratorConfig], wiring.Component]

MAKERS: dict[str, Maker] = {
    "eye_points": EyePoints, "eye_culls": EyeCulls, "pair_union": PairUnion, "list_sets": ListSets,
    "overlap_controller": OverlapController}
"""Makers of units that `rtl.units` does not have."""


class Part(NamedTuple):
    """A unit of machines with joint frames or with overlapped phases.

    Attributes:
        group: the group of the area report in which it counts.
        field: JOINT or OVERLAP, the field that changes the unit.
        machine: the machine with the field; without it, it is V3.
        instead: the units in whose place it is; None for the unit of its own name, and nothing for a unit that is new.
        count: how many of it a machine has.
    """

    group: str
    field: str = JOINT
    machine: AcceleratorConfig = V3_EYES
    instead: tuple[str, ...] | None = None
    count: int = 1


PARTS: dict[str, Part] = {
    "eye_points": Part(CULLING, instead=()),
    "eye_culls": Part(CULLING, instead=()),
    "pair_union": Part(CULLING, instead=()),
    "level_bounds": Part(CULLING, count=2),
    "supertile_clip": Part(CULLING),
    "supertile_reader": Part(LISTS),
    "pixel_writer": Part(LISTS),
    "batch_buffer": Part(BLENDING),
    "chunk_test": Part(CULLING),
    "near_test": Part(CULLING),
    "register_file": Part(CONTROL),
    "overlap_controller": Part(CONTROL, OVERLAP, V3_OVERLAP, instead=("frame_controller",)),
    "register_file of two frames": Part(CONTROL, OVERLAP, V3_OVERLAP),
    "list_sets": Part(LISTS, OVERLAP, V3_OVERLAP, instead=("depth_buckets", "tile_merge_unit")),
}
"""The units, small ones first, by their names and what more tells them apart."""

UNMEASURED = {
    JOINT: ("projection", "supertile_test", "pair_colour", "stream_buffer", "stream_arrays", "axi_master", "counters"),
    OVERLAP: ("splat_paths", "stream_arrays", "axi_master", "counters")}
"""Units that joint frames, or overlapped phases, change as well, and that are not synthesised with them."""


def measured(unit: str, config: AcceleratorConfig) -> dict[str, Any]:
    """Area in um^2, slack at CLOCK_PS and bits of memory of a unit in ASAP7."""
    make = MAKERS.get(unit) or UNITS[unit].make
    found = synthesise(make(config), unit, Settings("asap7", CLOCK_PS, ROOT / "build" / "results" / "synth"))
    return {key: found[key] for key in ("area_um2", "slack_ps", "memory_bits")}


def row_of(name: str, known: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """The numbers of one of PARTS; `known` are the rows of reports/synthesis.json."""
    part, unit = PARTS[name], name.split()[0]
    row: dict[str, Any] = {"unit": name, "group": part.group, "field": part.field, "count": part.count,
                           **measured(unit, part.machine)}
    others = (unit,) if part.instead is None else part.instead
    old = [known[other] if known.get(other, {}).get("config") == V3.name else measured(other, V3) for other in others]
    if not old:
        return {**row, "added_um2": row["area_um2"]}
    area = round(sum(one["area_um2"] for one in old), 2)
    return {**row, "alone_um2": area, "alone_slack_ps": min(one["slack_ps"] for one in old),
            "added_um2": round(part.count * row["area_um2"] - area, 2)}


def machines(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The areas of the machines of two eyes, and of those whose phases overlap, from the rows of the units."""
    packed = V3_STREAMS.with_(packed=True)
    found = []
    for config, one in ((V3_EYES, V3), (V3_EYES.with_(batch_places=1024), V3), (V3_EYES_STREAMS, packed),
                        (V3_EYES_STREAMS.with_(batch_places=1024), packed), (V3_OVERLAP, V3_OVERLAP),
                        (V3_EYES_OVERLAP, V3_OVERLAP)):
        area, single = estimate_area(config, rows), estimate_area(one, rows)
        found.append({"machine": config.name, "batch_places": config.batch_places, "mm2": round(area.mm2, 4),
                      "logic_mm2": round(area.logic_mm2, 4), "memory_mm2": round(area.memory_mm2, 4),
                      "one_eye_mm2": round(single.mm2, 4)})
    return found


def page(content: Mapping[str, Any]) -> str:
    """The report as a Markdown page."""
    sums = [
        (f"`{m['machine']}`", f"{m['batch_places']:,}", *(f"{m[name]:.3f}" for name in (
            "mm2", "logic_mm2", "memory_mm2", "one_eye_mm2"))) for m in content["machines"]]
    return "\n\n".join([
        "# Area of two eyes in one list, and of overlapped phases",
        "Written by `msv2 study run area_eyes`. Joint frames ([docs/stereo.md](../docs/stereo.md#joint-frames)) and overlapped "
        "phases ([docs/machine.md](../docs/machine.md#overlapped-phases)) add units to the machine and make others larger. "
        "Each was synthesised alone in ASAP7 for 1 ns, without wires, as [area.md](area.md) has it.",
        "## Units of joint frames", _units(content["rows"], JOINT),
        f"A machine has `level_bounds` twice. {_missing(JOINT)} The batch buffer of four arrays is taken to grow as much as "
        "that of one.",
        "## Units of overlapped phases", _units(content["rows"], OVERLAP),
        f"`list_sets` has two sets of lists and two tile merge units, in the place of one of each. {_missing(OVERLAP)} Instead "
        "of what `splat_paths` adds, a second tile test counts whole, although both phases share its datapath, and a second "
        "register file counts for the settings and counts of the second frame, which lie outside of it.",
        "## Machines",
        f"Areas at 16 nm, memories included, row width {V3_EYES.row_width:,}. The machine of one eye, with as many arrays, and "
        "with packed frames and overlapped phases where the other has them, stands beside. The goal for two eyes is "
        f"{GOAL_MM2} mm².",
        table(("machine", "places of a batch", "mm²", "logic", "memories", "one eye"), sums, 1)])


def _missing(field: str) -> str:
    kind = "Joint frames" if field == JOINT else "Overlapped phases"
    return (f"{kind} change these units as well, which are not synthesised with them, so that no sum has what they add, and "
            f"their timing is not known: {', '.join(f'`{name}`' for name in UNMEASURED[field])}.")


def _units(rows: Sequence[Mapping[str, Any]], field: str) -> str:
    return table(
        ("unit", "with, um²", "slack, ps", "without, um²", "added, um²", "bits of memory", "meets 1 ns"),
        [(f"`{r['unit']}`", f"{r['area_um2']:,.0f}", f"{r['slack_ps']:.0f}",
          f"{r['alone_um2']:,.0f}" if "alone_um2" in r else "-", f"{r['added_um2']:,.0f}",
          f"{r['memory_bits']:,}", "yes" if r["slack_ps"] >= 0 else "NO")
         for r in rows if r["field"] == field], 1)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line."""
    parser = command_parser("msv2 study run area_eyes", __doc__)
    parser.add_argument("--unit", choices=list(PARTS), action="append",
                        help="update only this row; may be given several times")
    args = parser.parse_args(argv)
    known = {row["unit"]: row for row in read_json(REPORTS / "synthesis.json")["rows"]}
    old = read_json(newest(REPORT_OF_EYES)) if args.unit else None
    found = {row["unit"]: {"field": PARTS[row["unit"]].field, **row} for row in old["rows"]} if old else {}
    progress = Progress("area_eyes", args.unit or list(PARTS))
    for name in args.unit or PARTS:
        with progress.step(name):
            found[name] = row_of(name, known)
    rows = [found[name] for name in PARTS if name in found]
    content = {"clock_ps": CLOCK_PS, "goal_mm2": GOAL_MM2, "rows": rows, "machines": machines(rows)}
    write_report(REPORT_OF_EYES, content, [__name__], {
        "arguments": args, **{c.name: c for c in (V3_EYES, V3_EYES_STREAMS, V3_OVERLAP, V3_EYES_OVERLAP)}}, liberties(), old)
    write_page(REPORT_OF_EYES.with_suffix(".md"), page(content))
    return 0


if __name__ == "__main__":
    run_command_line(main)
