"""Plays drawn frames batch by batch, and keeps count in a file from which a later run goes on."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from golden.scenes.files import atomic_output
from golden.scenes.save import save_model
from msv2.cases.soak import draw, shrink
from msv2.cases.soak.draw import Drawn
from spec.config import AcceleratorConfig
from spec.errors import InputError
from tb.common.runner import SimulationError
from tb.top.suite import VARIANTS, run_plan

MACHINES: Mapping[str, AcceleratorConfig] = {
    name: VARIANTS[name] for name in (
        "tiny", "tiny_records_stereo", "tiny_v3", "tiny_v3_packed", "tiny_streams_packed", "tiny_eyes_streams")}
"""The machines that take turns. They have every unit of the full ones, with smaller arrays and memories."""

BATCH = 16
"""Frames of a simulation."""


def frames_of(config: AcceleratorConfig, machine: str, seed: int, batch: int) -> list[Drawn]:
    """The frames of a batch, always the same."""
    rng = np.random.default_rng([seed, batch])
    return [draw.draw(config, rng, f"{machine} {seed}:{batch}:{n}") for n in range(BATCH)]


def play(config: AcceleratorConfig, frames: Sequence[Drawn], folder: Path) -> tuple[int, dict[int, list[str]]]:
    """Plays frames in one simulation. Returns its cycles, and what is wrong, by the frame's number. A simulation that does not
    end well is a failure of its last frame."""
    plan = draw.plan(config, frames)
    try:
        outcome = run_plan(config, plan, folder)
    except SimulationError as error:
        return 0, {len(plan) - 1: [f"the simulation failed: {error}"]}
    return outcome.cycles, {n: outcome.failures[item.name] for n, item in enumerate(plan) if item.name in outcome.failures}


class Soak:
    """The count of a soak, in `soak.json` of a folder.

    Parameters:
        folder: the folder; what is in it is continued.
        seed: selects the frames.
        machines: names of MACHINES, which take turns.

    Raises:
        InputError: the folder has a soak of another seed or of other machines.
    """

    def __init__(self, folder: Path, seed: int, machines: Sequence[str]):
        self.folder, self.file = folder, folder / "soak.json"
        self.count: dict[str, Any] = {
            "seed": seed, "machines": list(machines), "batches": 0, "cycles": 0, "frames": 0, "by_machine": {}, "by_end": {},
            "differences": []}
        if self.file.exists():
            before = json.loads(self.file.read_text())
            for name in ("seed", "machines"):
                if before[name] != self.count[name]:
                    raise InputError(f"{self.file} has a soak of {name} {before[name]!r}, not {self.count[name]!r}: "
                                     "give the same, or another --out")
            self.count = before

    def run(self, cycles: int, tick: Callable[[int], object] = lambda cycles: None) -> bool:
        """Plays batches until there are `cycles` in all, or a frame differs; returns whether none did."""
        while self.count["cycles"] < cycles and not self.count["differences"]:
            tick(self._batch())
        return not self.count["differences"]

    def _batch(self) -> int:
        names, number = self.count["machines"], self.count["batches"]
        machine = names[number % len(names)]
        config = MACHINES[machine]
        frames = frames_of(config, machine, self.count["seed"], number)
        cycles, wrong = play(config, frames, self.folder / "simulation")
        row = self.count["by_machine"].setdefault(machine, {"frames": 0, "cycles": 0})
        row["frames"] += len(frames)
        row["cycles"] += cycles
        self.count["by_end"] = dict(Counter(self.count["by_end"]) + Counter(frame.fate for frame in frames))
        self.count |= {"batches": number + 1, "cycles": self.count["cycles"] + cycles,
                       "frames": self.count["frames"] + len(frames)}
        if wrong:
            first = min(wrong)
            self.count["differences"].append({"machine": machine, "batch": number, "frame": first, "words": wrong[first]})
        self._save()
        return cycles

    def _save(self) -> None:
        with atomic_output(self.file) as file:
            file.write((json.dumps(self.count, indent=1) + "\n").encode())

    def smallest(self) -> tuple[list[Drawn], Path]:
        """The first difference with as few frames and Gaussians as possible, and the folder of its models."""
        found = self.count["differences"][0]
        config = MACHINES[found["machine"]]
        frames = frames_of(config, found["machine"], self.count["seed"], found["batch"])[: found["frame"] + 1]

        def fails(frames: Sequence[Drawn]) -> bool:
            return len(frames) - 1 in play(config, frames, self.folder / "simulation")[1]

        frames = shrink.fewest_gaussians(shrink.fewest_frames(frames, fails), fails)
        folder = self.folder / f"{found['machine']}-{self.count['seed']}-{found['batch']}-{found['frame']}"
        folder.mkdir(parents=True, exist_ok=True)
        for number, frame in enumerate(frames):
            save_model(frame.model, folder / f"{number}.ply")
        return frames, folder
