"""What lists by super-tile replace: the area of `mono` beside that of `v3`, by group and by part of the machine.

Groups are those of the two builds. Parts are sums over their units. The units of machines with lists by tile are those of the
build `1ghz` without the warp unit, because the report keeps the units of that build; its array has the wider weights that a
second eye needs, so that the parts of the old machine add up to slightly more than `mono`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from msv2.studies.page import table
from synth.machine import WARP

TILE_LISTS, SUPERTILE_LISTS = "mono", "v3"
"""The builds whose groups are compared."""

_SORTER = tuple(f"render.sorter{inner}" for inner in ("", ".sorter", ".writer", ".reader", ".tree"))
_ARRAY = tuple(f"render.array{inner}" for inner in ("", ".setup", ".sequencer", ".expand", ".collect"))
_CONTROL = ("msv2_top", "registers", "controller", "master", "counters", "geometry", "render")

PARTS: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "Gaussians from memory": (
        ("geometry.reader", "queue_geometry"),
        ("geometry.reader", "queue_geometry", "geometry.headers", "queue_chunks")),
    "chunk test": ((), ("geometry.bounds", "geometry.chunk_test")),
    "projection": (("geometry.projection",), ("geometry.path.projection", "geometry.path", "geometry.path.clip")),
    "tile test": (("geometry.tile_test", "geometry.loader", "queue_tiles"),
                  ("geometry.path.tile_test", "geometry.loader", "queue_tiles")),
    "colour": (("geometry.colour", "queue_colour"), ("render.colour", "queue_colour")),
    "lists written": (("geometry.writer",), ("geometry.writer", "geometry.buckets")),
    "lists merged": (("render.tile_merge",), ("render.tile_merge",)),
    "lists read": (("render.fork", "render.reader", "render.headers", "queue_entries"),
                   ("render.fork", "render.reader", "render.supertiles", "render.supertile_fork", "render.queue",
                    "render.lists", "queue_entries")),
    "sorting": ((*_SORTER, "render.handover", "queue_spill"), (*_SORTER, "render.handover", "queue_spill")),
    "splat records": (("render.fetch", "queue_views"), ("render.fetch", "render.batches")),
    "array and blending": (_ARRAY, (*_ARRAY, "render.array.state")),
    "pixels written": (("render.finished", "render.writer"), ("render.finished", "render.writer")),
    "control and bus": ((*_CONTROL, "geometry.saturations"),
                        (*_CONTROL, "geometry.path.saturations", "render.saturations")),
}
"""Units of each part: in a machine with lists by tile, and in one with lists by super-tile."""


def units_of(rows: Iterable[Mapping[str, object]]) -> list[dict[str, object]]:
    """What a build keeps of its units, given as rows of an `AreaReport`."""
    kept = ("unit", "group", "logic_um2", "slack_ps", "memory_bits", "logic_um2_16nm", "memory_um2_16nm")
    return [{key: row[key] for key in kept} for row in rows]


def parts(report: Mapping[str, object]) -> list[tuple[str, tuple[float, float], tuple[float, float]]]:
    """For each of PARTS, logic and memories of both machines in um^2 at 16 nm.

    Raises:
        ValueError: a unit belongs to no part, or a part's unit is not in the report.
    """
    before = [row for row in report["rows"] if row["group"] != WARP]
    after = report["builds"][SUPERTILE_LISTS]["units"]
    for place, rows in enumerate((before, after)):
        named, found = {unit for pair in PARTS.values() for unit in pair[place]}, {row["unit"] for row in rows}
        if named != found:
            raise ValueError(f"parts must have the units of the report, not {', '.join(sorted(named ^ found))} besides")
    return [(name, _sum(before, pair[0]), _sum(after, pair[1])) for name, pair in PARTS.items()]


def _sum(rows: Sequence[Mapping[str, object]], units: Sequence[str]) -> tuple[float, float]:
    chosen = [row for row in rows if row["unit"] in units]
    return sum(row["logic_um2_16nm"] for row in chosen), sum(row["memory_um2_16nm"] for row in chosen)


def section(report: Mapping[str, object]) -> str:
    """The section of the page, as Markdown."""
    builds = report["builds"]
    if SUPERTILE_LISTS not in builds:
        return f"The report has no build `{SUPERTILE_LISTS}` (`make report-area BUILDS={SUPERTILE_LISTS}`).\n"
    old, new = builds[TILE_LISTS], builds[SUPERTILE_LISTS]
    groups = [(name, *(tuple(build["groups"].get(name, {}).get(key, 0.0) for key in ("logic_um2_16nm", "memory_um2_16nm"))
                       for build in (old, new))) for name in old["groups"] | new["groups"]]
    text = (f"`{SUPERTILE_LISTS}` takes {new['mm2_16nm']:.3f} mm² where `{TILE_LISTS}` takes {old['mm2_16nm']:.3f}. All "
            f"numbers below are um² at 16 nm.\n\n{_compared('group', groups)}\n")
    return text + (
        "\nBy part of the machine, from the units of both. The units of the machine with lists by tile are those of `1ghz` "
        f"without the warp unit, whose array is made for two eyes:\n\n{_compared('part', parts(report))}\n"
        f"\nUnits that only `{SUPERTILE_LISTS}` has, or that are others there:\n\n{_new_units(new['units'])}\n")


def _compared(what: str, rows: Sequence[tuple[str, tuple[float, float], tuple[float, float]]]) -> str:
    total = [tuple(sum(row[side][kind] for row in rows) for kind in (0, 1)) for side in (1, 2)]
    lines = [(name, *(f"{value:,.0f}" for value in (*old, *new, sum(new) - sum(old))))
             for name, old, new in (*rows, ("all", *total))]
    return table((what, "logic of the old", "memories of the old", f"logic of `{SUPERTILE_LISTS}`",
                  f"memories of `{SUPERTILE_LISTS}`", "difference"), lines, 1)


def _new_units(units: Sequence[Mapping[str, object]]) -> str:
    changed = {unit for _, after in PARTS.values() for unit in after}
    same = {"queue_geometry", "queue_tiles", "queue_colour", "queue_entries", "queue_spill", "geometry.loader", "render.fork",
            "render.finished", "render.writer", *_CONTROL}
    rows = [(f"`{row['unit']}`", f"{row['logic_um2']:,.0f}", "-" if row["slack_ps"] is None else f"{row['slack_ps']:,.0f}",
             f"{row['memory_bits']:,.0f}", f"{row['logic_um2_16nm']:,.0f}", f"{row['memory_um2_16nm']:,.0f}")
            for row in units if row["unit"] in changed - same]
    return table(("unit", "logic, um² ASAP7", "slack at 1 ns, ps", "memory bits", "logic, um² at 16 nm",
                  "memories, um² at 16 nm"), rows, 1)
