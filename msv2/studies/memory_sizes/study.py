"""The area of machines if small memories cost more a bit: writes reports/memory_sizes.json and memory_sizes.md.

    msv2 study run memory_sizes

The memories of each machine are those of its area estimate (`msv2.studies.area.stores`), and so is its logic. Nothing is
synthesised.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from msv2.studies.area.estimate import estimate_area
from msv2.studies.area.stores import stores
from msv2.studies.destination import newest
from msv2.studies.page import table, write_page
from msv2.studies.record import liberties, write_report
from spec.command_line import command_parser
from spec.config import PAPER, V3, V3_EYES_LARGE, V3_STREAMS_PACKED, AcceleratorConfig
from spec.paths import REPORTS
from synth.macro_sizes import ANCHORED, SCALED, SECOND_PORT, SizedMacro, make_sized
from synth.macro_sizes import table as macro_table
from synth.macro_timing import ACCESS_PS
from synth.macros import make
from synth.memories import Macro
from synth.scaling import TO_16NM

MACHINES = {
    "paper": PAPER, "paper, two eyes": PAPER.with_(stereo=True), "v3": V3, "v3_streams_packed": V3_STREAMS_PACKED,
    "v3_eyes_large": V3_EYES_LARGE}
"""The machines of the report, by label."""


def machine_row(label: str, config: AcceleratorConfig, macros: tuple[SizedMacro, ...]) -> dict[str, object]:
    """A machine's row: its memories and its whole area in mm^2 at 16 nm, by table."""
    area = estimate_area(config)
    totals = {"flat": 0.0, ANCHORED: 0.0, SCALED: 0.0}
    slowest = {ANCHORED: 0.0, SCALED: 0.0}
    memories = []
    for store in stores(config):
        shape = Macro(store.words, store.width, 1, 1)
        found = {way: make_sized(shape, way, macros) for way in (ANCHORED, SCALED)}
        flat = store.count * make(shape).area_um2 * TO_16NM["asap7"].area
        totals["flat"] += flat
        for way, sized in found.items():
            totals[way] += store.count * sized.um2
            slowest[way] = max(slowest[way], sized.access_ps)
        memories.append({
            "unit": store.unit, "name": store.name, "count": store.count, "words": store.words, "width": store.width,
            "bits": store.count * shape.bits, "flat_um2": round(flat, 1),
            **{f"{way}_um2": round(store.count * sized.um2, 1) for way, sized in found.items()},
            "built_of": {way: f"{sized.macros} of {sized.kind}".removeprefix("0 of ") for way, sized in found.items()}})
    # The estimate's own memories may differ a little from the flat table's sum: synthesised builds have their real lists.
    mm2 = {way: round(area.mm2 + (total - totals["flat"]) / 1e6, 4) for way, total in totals.items()}
    return {"machine": label, "memory_mm2": {way: round(total / 1e6, 4) for way, total in totals.items()}, "mm2": mm2,
            "basis": area.basis, "access_ps": {way: round(ps, 1) for way, ps in slowest.items()}, "memories": memories}


def page(report: Mapping) -> str:
    """The report as a Markdown page."""
    names = {"flat": "one price a bit", ANCHORED: "by size, anchored", SCALED: "by size, scaled from 45 nm"}
    areas = ((f"`{row['machine']}`", *(f"{row['memory_mm2'][way]:.3f}" for way in names),
              *(f"{row['mm2'][way]:.3f}" for way in names)) for row in report["machines"])
    head = ("machine", *(f"memories, mm²: {name}" for name in names.values()),
            *(f"machine, mm²: {name}" for name in names.values()))
    costs = ((f"{macro['words']} x {macro['width']}", f"{macro['um2_a_bit']:.3f}", f"{macro['over_densest']:.2f}",
              f"{macro['access_ps_45nm']:.0f}", f"{macro['access_ps_7nm']:.0f}") for macro in report["table"])
    worst = max(ps for row in report["machines"] for ps in row["access_ps"].values())
    intro = (
        "Written by `msv2 study run memory_sizes`. The area reports build memories of fakeram7's macros, which cost nearly the "
        "same a bit at every size. fakeram45's do not: its areas and access times are as CACTI gives them. *Anchored* takes "
        "from it how the price of a bit depends on size, relative to its densest macro, and the price of a bit from fakeram7. "
        f"*Scaled* takes its areas as they are, scaled from 45 nm, times {SECOND_PORT} for a second port. A memory is built of "
        "equal macros, the smallest way that there is, or of flip-flops. Square millimetres are at 16 nm.")
    times = (
        f"Timing gives each macro of fakeram7 {ACCESS_PS:.0f} ps. By fakeram45, scaled to ASAP7's node, the slowest macro that "
        f"a machine here uses takes {worst:.0f} ps: no access is faster in our timing than in this table.")
    sizes = ("words x bits", "µm² a bit at 45 nm, one port", "over the densest", "access, ps", "scaled to 7 nm, ps")
    return "\n\n".join(["# Memories under two tables of macros", intro, table(head, areas, left=1), times,
                        "## What fakeram45 says of sizes", table(sizes, costs, left=1)]) + "\n"


def main(argv: Sequence[str] | None = None) -> int:
    """Parses the command line and writes the reports; returns the exit status."""
    parser = command_parser("msv2 study run memory_sizes", __doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=REPORTS, metavar="DIR",
                        help="folder of the report (default: build/reports; --keep: reports)")
    args = parser.parse_args(argv)
    macros = macro_table()
    densest = min(macro.um2_a_bit for macro in macros)
    to_7nm = TO_16NM["nangate45"].delay / TO_16NM["asap7"].delay
    report = {
        "second_port": SECOND_PORT, "machines": [machine_row(label, config, macros) for label, config in MACHINES.items()],
        "table": [{"words": macro.words, "width": macro.width, "um2_a_bit": round(macro.um2_a_bit, 4),
                   "over_densest": round(macro.um2_a_bit / densest, 3), "access_ps_45nm": round(macro.access_ps, 1),
                   "access_ps_7nm": round(macro.access_ps * to_7nm, 1)} for macro in macros]}
    path = args.out / "memory_sizes.json"
    write_report(path, report, [__name__], {"arguments": args, "machines": MACHINES}, liberties())
    write_page(args.out / "memory_sizes.md", page(report))
    print(f"wrote {newest(path)} and memory_sizes.md")
    return 0
