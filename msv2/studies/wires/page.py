"""The report of placed units as a Markdown page."""

from __future__ import annotations

from collections.abc import Mapping

from msv2.studies.page import table


def page(report: Mapping[str, object]) -> str:
    """The whole page."""
    wires = report["wires"]
    intro = (
        "Written by `msv2 study run wires`. Each unit is mapped as in the area report, placed flat by coloquinte, and timed by "
        "OpenSTA with and without its wires. A net's wires are its shortest spanning tree, with "
        f"{wires['ohm_per_um']:g} ohm and {wires['ff_per_um']:g} fF a micrometre and {wires['via_ohm']:g} ohm of vias an edge "
        f"({wires['source']}). The clock is ideal. Nothing is sized, buffered or routed after placement: a layout would "
        "repair the longest nets, and its router would make detours. How it is done: [synthesis.md](../docs/synthesis.md).")
    sums = (
        f"**What follows.** The clock period of the unit that wires slow most grows by {100 * (report['derate'] - 1):.1f} %. "
        "Over all units, wires "
        f"have {report['wire_share']:.2f} of the capacitance of the pins that they lead to, and a clock tree takes "
        f"{report['tree_share']:.2f} of the energy of the pins and cells that it clocks.")
    return "\n\n".join(["# Wires of placed units", intro, sums, "## Delay and load", _delay(report), "## Clock trees",
                        _trees(report)]) + "\n"


def _delay(report: Mapping) -> str:
    head = ("unit", "commit", "cells", "flip-flops", "area of cells, µm²", "density", "wires, mm", "their fF over the pins'",
            "slack, ps", "with wires, ps", "period with wires over that without")
    return table(head, (
        (f"`{row['unit']}`", row["commit"], f"{row['cells']:,}", f"{row['flip_flops']:,}", f"{row['cell_um2']:,.0f}",
         f"{row['density']:.2f}", f"{row['wire_um'] / 1e3:,.1f}", f"{row['wire_share']:.2f}", f"{row['slack_ps']:.1f}",
         f"{row['wired_slack_ps']:.1f}", f"{row['derate']:.3f}") for row in report["units"]), left=2)


def _trees(report: Mapping) -> str:
    head = ("unit", "clocked pins", "buffers", "wires, µm", "wires, fJ a cycle", "buffers, fJ", "pins and cells, fJ",
            "tree over pins and cells")
    rows = ((f"`{row['unit']}`", f"{tree['sinks']:,}", f"{tree['buffers']:,}", f"{tree['um']:,.0f}", f"{tree['wire_fj']:,.0f}",
             f"{tree['buffer_fj']:,.0f}", f"{row['clock_fj']:,.0f}", f"{row['tree_share']:.2f}")
            for row in report["units"] for tree in [row["tree"]])
    return table(head, rows, left=1)
