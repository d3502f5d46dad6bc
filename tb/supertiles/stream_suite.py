"""The tests of the batch buffer of several streams: each stream must have the visits and entries that `spec.supertiles` wants
of it, less what belongs to regions that have stopped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from spec.config import TINY_STREAMS, V3_STREAMS, AcceleratorConfig
from spec.supertiles import SEQUENCE_BITS
from tb.common import exact
from tb.common.exact import Outcome
from tb.common.player import Recording, Run
from tb.common.runner import Waves
from tb.supertiles import batch_suite
from tb.supertiles.batch_device import Mode, playback
from tb.supertiles.batch_stimuli import EVERY, Case, Tiles, case_of, one_stream, random_case, wanted_batches, wanted_visits
from tb.supertiles.batch_suite import MOST_ENTRIES

VARIANTS: dict[str, AcceleratorConfig] = {
    "tiny_streams": TINY_STREAMS, "16-places": TINY_STREAMS.with_(batch_places=16), "v3_streams": V3_STREAMS,
    "tiny_eyes": TINY_STREAMS.with_(joint=True)}
"""Configurations that can be tested."""

DISTINCT = tuple(VARIANTS)
"""All configurations."""

PORTS = ("supertiles", "places", *(f"{name}_{q}" for name in ("visits", "entries") for q in range(4)))

ENTRIES_AHEAD = MOST_ENTRIES + 1
"""Entries of a region that may leave after the one with which it stops: one more than with one stream."""


@dataclass(frozen=True)
class Planned(exact.Planned):
    """A run with the plan of each stream."""

    streams: list[batch_suite.Planned] = field(default_factory=list)


class Plan:
    """Runs, and the number of the next super-tile.

    Attributes:
        runs: the runs added so far.
    """

    def __init__(self, config: AcceleratorConfig):
        self.runs: list[Planned] = []
        self._config, self._frame, self._sequence = config, 0, 0

    def add(
        self, case: Case, name: str | None = None, *, mode: Mode = Mode.NEVER, limit: int = 0, reset: bool = True,
        most_cycles: int | None = None, **options: object,
    ) -> None:
        """Adds the run that plays a case, as `batch_suite.Plan.add` does; `most_cycles` is that of the whole run."""
        self._frame = (self._frame + 1) % 256
        first = 0 if reset else self._sequence
        self._sequence = (first + len(case.supertiles) // case.eyes) % (1 << SEQUENCE_BITS)
        exactly, wanted = mode in (Mode.NEVER, Mode.STALE), {}
        every = [wanted_visits(self._config, case, first, q) for q in range(self._config.streams)]
        for q, visits in enumerate(every):
            wanted[f"visits_{q}"] = np.array([visit.row for visit in visits])
            wanted[f"entries_{q}"] = np.concatenate([visit.entries for visit in visits])
        quiet = options.pop("quiet", 400)
        run = Run(name or case.name, {"supertiles": case.supertiles, "places": case.places},
                  {port: len(rows) if exactly else 0 for port, rows in wanted.items()},
                  batch_suite.settings_of(self._config, case, mode, limit, self._frame), reset=reset, quiet=quiet, **options)
        observed = {"batches": len(wanted_batches(self._config, case)), "busy": 0}
        streams = [batch_suite.Planned(
            run, {"visits": wanted[f"visits_{q}"], "entries": wanted[f"entries_{q}"]} if exactly else {},
            observed if quiet else {}, most_cycles=most_cycles, visits=visits, mode=mode, limit=limit)
            for q, visits in enumerate(every)]
        self.runs.append(Planned(run, {}, streams=streams))


def problems(item: Planned, recording: Recording) -> list[str]:
    """What is wrong with a recording, stream by stream."""
    found, visits = [], 0
    for q, stream in enumerate(item.streams):
        rows = {name: recording.outputs[f"{name}_{q}"] for name in ("visits", "entries")}
        visits += len(rows["visits"])
        mine = replace(recording, outputs=rows, observed={**recording.observed, "visits_count": len(rows["visits"])})
        found += [f"stream {q}: {text}" for text in batch_suite.problems(stream, mine, ENTRIES_AHEAD)]
    if item.run.quiet and recording.observed["visits_count"] != visits:
        found.append(f"visits_count is {recording.observed['visits_count']}, not {visits}")
    return found


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """The cases of `batch_suite.add_cases`, and those of regions that stop."""
    plan, places = Plan(config), config.batch_places
    batch_suite.add_cases(plan, config, seed, PORTS)
    for stream in range(config.streams):
        case = one_stream(config, stream)
        plan.add(case, most_cycles=batch_suite.most_cycles(config, case, stream))
    dense = case_of(config, "dense", [
        Tiles([EVERY] * places * 3), Tiles([1] * places * 3, inside=1), Tiles([]), Tiles([0x8001] * places * 2)], seed)
    for mode in (Mode.AT_ONCE, Mode.AT_END, Mode.LATE):
        for limit in (1, places // 2):
            plan.add(dense, f"dense, {mode.name.lower()} after {limit}", mode=mode, limit=limit)
            case = random_case(config, "", seed + limit, supertiles=5, mean_pairs=4 * places, density=0.4)
            plan.add(case, f"random, {mode.name.lower()} after {limit}", mode=mode, limit=limit)
    return plan.runs


def run_plan(
    config: AcceleratorConfig, plan: Sequence[Planned], folder: Path, *, waves: Waves | None = None, progress: bool = False,
) -> Outcome:
    """Plays a plan and compares all results."""
    return exact.run_plan(playback(config), plan, folder, waves=waves, progress=progress, judge=problems)


full_plan = unit_plan
"""All runs."""


def figures(config: AcceleratorConfig, plan: Sequence[Planned], outcome: Outcome) -> list[str]:
    """One line per run with its places and the entries of each stream."""
    return [f"{item.name}: {recording.items['places']} places, "
            f"{', '.join(str(recording.items[f'entries_{q}']) for q in range(config.streams))} entries and ends, "
            f"{recording.cycles} cycles" for item, recording in exact.recorded(plan, outcome)]
