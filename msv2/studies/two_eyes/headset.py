"""Both eyes of a headset, 2064 by 2208 pixels each: cycles of joint frames on `headset`, and the frames a second that they are
worth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from msv2.studies.memory import LPDDR3, MEMORY_NAMES
from msv2.studies.page import table
from msv2.studies.performance.frames import scene_file
from msv2.studies.two_eyes.measure import ONE, SHARED, cycle_rows
from msv2.studies.v3.frames import Subject
from spec.config import HEADSET

SIZE = "2064x2208"
SCENES = ("garden_large", "bonsai")
"""A captured scene that others trained, and the one that `make train SCENE=bonsai` writes to build/train."""

MACHINES = {HEADSET.name: HEADSET, f"{HEADSET.name}, four arrays": HEADSET.with_(streams=4)}

CLOCKS_MHZ = (1000, 500)
"""Clocks at which LPDDR3's timings, which are nanoseconds, become cycles."""

GOAL_FPS = 200
"""Frames a second of both eyes that the machine should reach at the first clock."""


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
            for clock in CLOCKS_MHZ:
                found = cycle_rows(Subject(scene, SIZE), name, LPDDR3, config, clock)
                out += [row | {"clock_mhz": clock, "fps": 1e6 * clock / row["cycles"]} for row in found]
    return out


def section(content: Mapping[str, Any]) -> str:
    """The section of the page."""
    found: Sequence[Mapping[str, Any]] = content["headset"]
    absent = content["headset_missing"]
    text = (f"{SIZE} pixels an eye, four levels, the gaze in the left eye's centre, display pixels, {MEMORY_NAMES[LPDDR3]}, "
            f"whose timings are nanoseconds. `{HEADSET.name}` is `v3` for rows of {HEADSET.row_width:,} pixels, with "
            f"{HEADSET.list_heads:,} lists. A frame of two eyes is both of them; the goal is {GOAL_FPS} a second at "
            f"{CLOCKS_MHZ[0]:,} MHz." + (f" Not here: {', '.join(absent)} (`make train SCENE=bonsai`)." if absent else ""))
    cells = [(row["scene"], row["machine"], row["kind"], f"{row['clock_mhz']:,}", f"{row['cycles']:,}",
              f"{row['total_bytes'] / 1e6:.1f}", f"{row['fps']:.0f}") for row in found if row["kind"] != SHARED]
    head = ("scene", "machine", "frame", "MHz", "cycles", "MB", "frames a second")
    return f"{text}\n\n{table(head, cells, 3)}" if any(row["kind"] == ONE for row in found) else text
