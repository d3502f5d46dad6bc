"""The machine `fpga` as a whole in the report of FPGAs: what `msv2 fpga` found when it built and simulated the system."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from msv2.fpga import command, flow, tools
from msv2.studies import page

MODULES = ("msv2.fpga.command", "msv2.fpga.flow", "msv2.fpga.soc")
"""What made these numbers."""

FIELDS = ("fits", "fmax_mhz", "soc_bit_exact", "machine")
"""The report's fields that are of the machine as a whole."""

_KINDS = {"lut": "LUT", "ff": "flip-flops", "bram": "blocks of memory", "dsp": "multipliers"}


def measured(folder: Path, part: str) -> dict[str, object]:
    """Builds and simulates the system in a folder, which keeps the steps, and returns the report's fields. `part`: all, or
    unrouted, which leaves placing and routing out, and with it whether everything has a place, and the clock."""
    tools.check(command.packages(part))
    found = command.build(folder, part, next(iter(flow.DEVICES.values())), seed=1)
    return {**{name: found[name] for name in FIELDS[:3] if name in found},
            "machine": {key: value for key, value in found.items() if key not in FIELDS[:3]}}


def kept(report: Mapping[str, Any] | None) -> dict[str, object]:
    """The fields as an earlier report has them."""
    return {name: report[name] for name in FIELDS if report and name in report}


def table(report: Mapping[str, Any]) -> str:
    """What the system takes, and what else was found, in Markdown."""
    found = report.get("machine")
    if found is None:
        return "The report has no numbers of the machine yet: `msv2 study run fpga --machine all` measures them."
    rows = [[_KINDS[kind], f"{used:,}", f"{found['of'][kind]:,}", f"{100 * used / found['of'][kind]:.0f} %"]
            for kind, used in found["used"].items()]
    said = page.table([f"on {found['device']}", "taken", "there are", "share"], rows, left=1)
    soc, seconds = found["soc"], found["seconds"]
    numbers = soc["numbers"]
    lines = [["place and route", "not done: no clock, and no bitstream"]] if "fits" not in report else [
        ["everything has a place", "yes" if report["fits"] else "no"],
        ["clock after routing, asked for", f"{report['fmax_mhz']:.1f} MHz, {found['target_mhz']} MHz"],
        ["bitstream, not compressed", f"{found['bitstream_bytes']:,} bytes"]]
    lines += [
        ["frame by the firmware in simulation",
         f"{soc['size'][0]}x{soc['size'][1]} pixels, {soc['intersections']:,} intersections, "
         + ("bit-exact" if report["soc_bit_exact"] else "wrong")],
        ["cycles of that frame, and with the copy of the model", f"{numbers['cycles']:,}, {numbers['simulated_cycles']:,}"],
        ["minutes of the steps", ", ".join(f"{name} {seconds[name] / 60:.1f}" for name in ("synthesis", "place", "route", "soc")
                                           if name in seconds)],
    ]
    return said + "\n\n" + page.table(["found", ""], lines, left=2)
