"""Cases of the machine alone: 41 (errors), 53, 54 and 55. The expected frames are golden ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from golden.msv2_ref.pipeline import render
from golden.scenes.gaze import Display, foveation_map
from msv2.cases.case import Case
from msv2.cases.check import MACHINE, Cell
from msv2.cases.makers import random_model, turned_view, view
from msv2.cases.order import crowded
from spec.codes import ErrorCode
from spec.memory import FIRST_PAGE_BEATS
from tb.sort_tmu import tile_merge_suite as tmu
from tb.top.planned import SPEEDS, PlannedFrame, planned
from tb.top.stimuli import Case as Played

_ELSEWHERE = dict.fromkeys(("oracle", "golden", "gradient"), "of the machine alone")


@dataclass(frozen=True)
class MachineCase(Case):
    """A case of the machine: `frames` makes the frames to play; `unit` runs one unit besides and returns its failures."""

    frames: Callable[[], list[PlannedFrame]] | None = None
    unit: Callable[[Path], dict[str, list[str]]] | None = None


def scene(
    name: str, seed: int = 0, size: tuple[int, int] = (48, 33), *, levels: int = 1, sh: int = 1, count: int = 80,
) -> Played:
    """A golden frame of random splats; it is foveated where it has several levels."""
    model = random_model(np.random.default_rng(seed), count, levels, sh)
    foveation = foveation_map(Display(*size), (size[0] / 3, size[1] / 2), levels) if levels > 1 else None
    frame = render(model, turned_view(*size), config=MACHINE, foveation=foveation, background=(0.25, 0.5, 0.75))
    return Played(name, frame, None, False)


def _memories() -> list[PlannedFrame]:
    played = scene("53: a frame", levels=4, sh=2)
    return [planned(played, f"{speed} memory", speed, reset=False, poison=False) for speed in SPEEDS]


def _ports(folder: Path) -> dict[str, list[str]]:
    """Runs the tile merge unit with pauses of every kind, on each port alone and on all."""
    plan = [item for item in tmu.unit_plan(MACHINE, 0) if "pauses" in item.name]
    return tmu.run_plan(MACHINE, plan, folder).failures


def _resets() -> list[PlannedFrame]:
    before, after = scene("54: cut off", 1), scene("54: whole", 2, levels=4)
    plan = []
    for cycles in (1, 60, 400, 1500):
        plan.append(planned(before, f"after {cycles} cycles", cut=cycles))
        plan.append(planned(after, f"behind a reset at {cycles}"))
    for cycles in (5, 700):
        plan.append(planned(before, f"aborted after {cycles} cycles", error=ErrorCode.ABORTED, abort=cycles))
        plan.append(planned(after, f"behind an abort at {cycles}", reset=False))
    return plan


def _different() -> list[PlannedFrame]:
    frames = [scene("55: degree 0", 3, sh=0), scene("55: four levels", 4, (90, 60), levels=4, sh=3),
              scene("55: one pixel", 5, (1, 1)), scene("55: no splats", 6, (40, 20), count=0), scene("55: a row", 7, (200, 3)),
              scene("55: degree 0 again", 3, sh=0)]
    return [planned(frame, f"display {n % 2}", display=n % 2 == 1, reset=False, poison=False) for n, frame in enumerate(frames)]


def _errors() -> list[PlannedFrame]:
    chunk = MACHINE.sort_chunk
    model = crowded(2 * chunk + 5, 3)
    frame = render(model, view(16, 16, cx=32.0, cy=24.0), config=MACHINE, beta=0)
    large, right = Played("41: too many entries", frame, 0, False), scene("41: right", 8)
    broken = [planned(large, "no room for second pages", error=ErrorCode.ENTRIES_FULL,
                      changes={"entries_beats": FIRST_PAGE_BEATS}, reset=False),
              planned(large, "no room for runs", error=ErrorCode.SPILL_FULL, changes={"spill_beats": 2}, reset=False)]
    plan = []
    for item in broken:
        plan += [item, planned(right, f"after: {item.name}", reset=False)]
    return [*plan, planned(large, "with room", reset=False)]


def _case(number: int, name: str, what: str, expected: str, **options: object) -> MachineCase:
    return MachineCase(number, name, what, expected, columns=(), absent=_ELSEWHERE, **options)


CASES = (
    _case(41, "recoverable-errors", "more entries than there is room for, and more sorted runs",
          "ENTRIES_FULL and SPILL_FULL, and the next frame is right; with room, the frame itself", frames=_errors),
    _case(53, "pauses-on-every-port", "memories from one cycle to 400, slow, with random pauses; pauses on each port of a unit",
          "the same pixels; payloads hold until they are taken", frames=_memories, unit=_ports),
    _case(54, "reset-in-mid-frame", "resets after 1 to 1,500 cycles, and aborts",
          "the next frame is right in every bit and counter", frames=_resets),
    _case(55, "frames-back-to-back", "frames of other sizes, levels, degrees and pixel formats, without a reset in between",
          "each is right, the first one again at the end, too", frames=_different),
)


def unit_cell(case: MachineCase, folder: Path) -> Cell:
    """Runs a case's unit and returns its cell."""
    wrong = case.unit(folder / case.name)
    words = "; ".join(f"{run}: {problems[0]}" for run, problems in list(wrong.items())[:3])
    return Cell("FAIL" if wrong else "pass", None if wrong else 0.0, words)
