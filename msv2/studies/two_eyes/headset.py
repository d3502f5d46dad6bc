"""Both eyes of a headset, 2064 by 2208 pixels each: cycles of joint frames on `headset`, and the frames a second that they are
worth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from golden.scenes.files import read_json
from msv2.studies.memory import LPDDR3, MEMORY_NAMES
from msv2.studies.page import table
from msv2.studies.performance.frames import scene_file
from msv2.studies.two_eyes.measure import ONE, SHARED, cycle_rows
from msv2.studies.v3.frames import Subject
from spec.config import HEADSET, V3
from spec.paths import REPORTS
from synth.scaling import DELAY_TO_16NM

SIZE = "2064x2208"
SCENES = ("garden_large", "bonsai")
"""A captured scene that others trained, and the one that `make train SCENE=bonsai` writes to build/train."""

MACHINES = {
    HEADSET.name: HEADSET.with_(joint=True), f"{HEADSET.name}, four arrays": HEADSET.with_(joint=True, streams=4),
    f"{HEADSET.name}, four arrays, packed frames": HEADSET.with_(joint=True, streams=4, packed=True)}

TIMING = REPORTS / "machine_timing.json"

GOAL_FPS, SLOW_GOAL_FPS = 200, 90
"""Frames a second of both eyes that the machine should reach at 1 GHz, and at the clock that it reaches at 16 nm."""


def clocks_mhz() -> tuple[int, ...]:
    """Clocks at which LPDDR3's timings, which are nanoseconds, become cycles: 1 GHz, half of it, and that of `v3` at 16 nm,
    which is scaled from reports/machine_timing.json (typical corner, without wires)."""
    found = read_json(TIMING)["machines"][V3.name]["typical"]["ghz"]
    return 1000, 500, int(1000 * found / DELAY_TO_16NM["asap7"])


def missing() -> list[str]:
    """The scenes that are not here."""
    return [scene for scene in SCENES if scene_file(scene) is None]


def rows() -> list[dict[str, object]]:
    """The numbers of each frame, machine and clock, JSON-ready: those of `measure.cycle_rows`, `clock_mhz`, and frames a second
    as `fps`. With two eyes a frame is both of them."""
    out = []
    for scene in SCENES:
        if scene in missing():
            continue
        for name, config in MACHINES.items():
            for clock in clocks_mhz():
                found = cycle_rows(Subject(scene, SIZE), name, LPDDR3, config, clock)
                out += [row | {"clock_mhz": clock, "fps": 1e6 * clock / row["cycles"]} for row in found]
    return out


def section(content: Mapping[str, Any]) -> str:
    """The section of the page."""
    found: Sequence[Mapping[str, Any]] = content["headset"]
    absent = content["headset_missing"]
    text = (f"{SIZE} pixels an eye, four levels, the gaze in the left eye's centre, display pixels, {MEMORY_NAMES[LPDDR3]}, "
            f"whose timings are nanoseconds. `{HEADSET.name}` is `v3` for rows of {HEADSET.row_width:,} pixels, with "
            f"{HEADSET.list_heads:,} lists. A frame of two eyes is both of them. The goals are {GOAL_FPS} a second at "
            f"1,000 MHz, and {SLOW_GOAL_FPS} at the clock of `{V3.name}` at 16 nm, the lowest one here, which is scaled from "
            "reports/machine_timing.md and has no wires."
            + (f" Not here: {', '.join(absent)} (`make train SCENE=bonsai`)." if absent else ""))
    cells = [(row["scene"], row["machine"], row["kind"], f"{row['clock_mhz']:,}", f"{row['cycles']:,}",
              f"{row['total_bytes'] / 1e6:.1f}", f"{row['fps']:.0f}") for row in found if row["kind"] != SHARED]
    head = ("scene", "machine", "frame", "MHz", "cycles", "MB", "frames a second")
    return f"{text}\n\n{table(head, cells, 3)}" if any(row["kind"] == ONE for row in found) else text
