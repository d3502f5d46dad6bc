"""Plays the cases' golden frames through the machine and compares every pixel and counter. All cases share one simulation per
machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from msv2.cases.case import GOLDEN, Case
from msv2.cases.check import MACHINE, Cell, see_golden
from msv2.cases.chunks import CHUNK_MACHINE
from msv2.cases.eyes import STEREO_MACHINE
from msv2.cases.supertiles import SUPER_MACHINE
from spec.config import AcceleratorConfig
from tb.common.runner import SimulationError
from tb.top.planned import PlannedFrame, planned
from tb.top.stimuli import Case as Played
from tb.top.suite import run_plan

MACHINES: Mapping[str, AcceleratorConfig] = {
    "one eye": MACHINE, "two eyes": STEREO_MACHINE, "chunks": CHUNK_MACHINE, "super-tiles": SUPER_MACHINE}
"""The configurations that play cases."""


def frames_of(case: Case) -> dict[str, list[PlannedFrame]]:
    """A case's frames by machine. Each is played without a reset and over the memory that the previous frame left. Empty where
    the case has no part."""
    if not case.rtl:
        return {}
    found: dict[str, list[PlannedFrame]] = {name: [] for name in MACHINES}
    if case.shots is not None and "golden" in case.columns:
        for name, shot in case.shots(GOLDEN).items():
            played = Played(f"{case.id}: {name}", see_golden(shot).frame, shot.beta, shot.obb)
            found["one eye"].append(planned(played, reset=False, poison=False))
    if case.eyes is not None:
        for name, eyes in case.eyes().items():
            found["two eyes"].append(planned(Played(f"{case.id}: {name}", eyes.frame, None, False), reset=False, poison=False))
    for machine, frames in (("one eye", case.raw), ("chunks", case.chunks), ("super-tiles", case.supertiles)):
        for name, shot in (frames() if frames is not None else {}).items():
            played = Played(f"{case.id}: {name}", shot.check(name), None, False)
            found[machine].append(planned(played, reset=False, poison=False))
    return {machine: frames for machine, frames in found.items() if frames}


Plans = Mapping[str, Mapping[str, Sequence[PlannedFrame]]]
"""Frames by the case's id, then by machine."""


def check(plans: Plans, folder: Path, *, progress: bool = False) -> dict[str, Cell]:
    """Plays plans of frames and returns a cell for each case.

    Args:
        plans: the frames to play, by the case's id and by machine.
        folder: the folder for images, frames and logs.
        progress: whether to show progress bars.
    """
    failures: dict[str, list[str]] = {case: [] for case in plans}
    seconds = dict.fromkeys(plans, 0.0)
    for number, (machine, config) in enumerate(MACHINES.items()):
        frames = [(case, frame) for case, by_machine in plans.items() for frame in by_machine.get(machine, ())]
        if not frames:
            continue
        try:
            outcome = run_plan(config, [frame for _, frame in frames], folder / f"machine{number}", progress=progress)
        except SimulationError as error:
            for case, _ in frames:
                failures[case].append(f"the simulation failed: {error}")
            continue
        for case, frame in frames:
            failures[case] += [f"{frame.name}: {problem}" for problem in outcome.failures.get(frame.name, ())]
            if frame.name in outcome.recordings:
                seconds[case] += outcome.recordings[frame.name].seconds
    return {case: Cell("FAIL" if wrong else "pass", None if wrong else 0.0, "; ".join(wrong[:3]), seconds[case])
            for case, wrong in failures.items()}
