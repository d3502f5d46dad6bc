"""Test plans for units whose every output is known in advance: runs, the rows that they must give, and how fast they must
be."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from spec.config import AcceleratorConfig
from tb.common.patterns import Pattern
from tb.common.playback import Playback
from tb.common.player import Recording, Run, play
from tb.common.runner import Waves

_SHOWN = 5

_player: ContextVar[Callable[..., list[Recording]]] = ContextVar("player", default=play)


@contextmanager
def played_by(player: Callable[..., list[Recording]]) -> Iterator[None]:
    """While it is open, plans are played by `player`, with the arguments of `tb.common.player.play`, and judged as ever."""
    token = _player.set(player)
    try:
        yield
    finally:
        _player.reset(token)


@dataclass(frozen=True)
class Planned:
    """A run and its expected results.

    Attributes:
        run: the recording to play.
        expected: the rows of every output stream.
        observed: the final values of plain outputs; outputs that are not named here are not checked.
        least_rate: for an input port, the least permitted number of items accepted per cycle in which an item is offered.
        most_cycles: the largest permitted number of cycles from the start to the last item; None for no limit.
    """

    run: Run
    expected: Mapping[str, np.ndarray]
    observed: Mapping[str, int] = field(default_factory=dict)
    least_rate: Mapping[str, float] = field(default_factory=dict)
    most_cycles: int | None = None

    @property
    def name(self) -> str:
        """The run's name, for reports."""
        return self.run.name


@dataclass
class Outcome:
    """The outcome of a plan.

    Attributes:
        failures: descriptions of problems by the run's name; empty when all is well.
        recordings: by name, the outputs of every run that was not aborted.
        runs, items, cycles: the numbers of compared runs, compared items and simulated cycles.
        seconds: wall time, including the build.
    """

    failures: dict[str, list[str]] = field(default_factory=dict)
    recordings: dict[str, Recording] = field(default_factory=dict)
    runs: int = 0
    items: int = 0
    cycles: int = 0
    seconds: float = 0.0

    @property
    def amount(self) -> str:
        """The amount of compared data, in words."""
        return f"{self.items} items"


def planned(
    name: str, inputs: Mapping[str, np.ndarray], expected: Mapping[str, np.ndarray], *,
    observed: Mapping[str, int] | None = None, least_rate: Mapping[str, float] | None = None, most_cycles: int | None = None,
    **options: object,
) -> Planned:
    """A run that must give `expected`; `options` are further arguments of `Run`."""
    run = Run(name, inputs, {port: len(rows) for port, rows in expected.items()}, **options)
    return Planned(run, expected, observed or {}, least_rate or {}, most_cycles)


def every_pattern(ports: Sequence[str], seed: int) -> dict[str, dict[str, tuple[Pattern, int]]]:
    """Pause patterns of the ports by a name for the run: each kind of pattern on each port alone, and on all ports together."""
    return {
        f"{pattern.value} pauses of {', '.join(paused)}": {port: (pattern, seed + i) for i, port in enumerate(paused)}
        for pattern in (Pattern.ALWAYS, Pattern.RANDOM, Pattern.BURSTY)
        for paused in (*((port,) for port in ports), tuple(ports))}


def backpressure(inputs: Sequence[str], outputs: Sequence[str], seed: int) -> dict[str, dict[str, tuple[Pattern, int]]]:
    """Pause patterns by a name for the run: outputs that hold everything up until the whole unit is full, while the inputs
    pause in half of the cycles, so that gaps lie between the items inside; and the same with inputs that never pause."""
    tides = {port: (Pattern.TIDAL, seed + i) for i, port in enumerate(outputs)}
    gaps = {port: (Pattern.RANDOM, seed + i) for i, port in enumerate(inputs)}
    return {"full again and again": tides, "full again and again, with gaps": {**tides, **gaps}}


def rate(recording: Recording, port: str) -> float:
    """Items that an input port accepted per cycle in which one was offered."""
    return recording.items[port] / max(recording.items[port] + recording.stalls[port], 1)


def recorded(plan: Sequence[Planned], outcome: Outcome) -> Iterator[tuple[Planned, Recording]]:
    """The runs of a plan that were not aborted, each with its recording."""
    return ((item, outcome.recordings[item.name]) for item in plan if item.name in outcome.recordings)


def at_full_rate(plan: Sequence[Planned], outcome: Outcome, *kinds: str) -> Iterator[tuple[Planned, Recording]]:
    """The recorded runs that measure the unit's speed: their names begin with one of `kinds`, by default "rate" or "traced"."""
    return (pair for pair in recorded(plan, outcome) if pair[0].name.startswith(kinds or ("rate", "traced")))


def run_plan(
    playback: Playback, plan: Sequence[Planned], folder: Path, *, waves: Waves | None = None, progress: bool = False,
    watchdog: int = 20_000, judge: Callable[[Planned, Recording], list[str]] | None = None,
) -> Outcome:
    """Plays a plan and compares all results. Raises SimulationError when the simulation itself fails.

    For `watchdog` see `play`. `judge` lists what is wrong with the recording of a run; None stands for `problems`.
    """
    begin, outcome = time.perf_counter(), Outcome()
    played = _player.get()(
        playback, [item.run for item in plan], folder, waves=waves, progress=progress, watchdog=watchdog)
    for item, recording in zip(plan, played, strict=True):
        outcome.cycles += recording.cycles
        if item.run.abort is not None:
            continue
        outcome.runs += 1
        outcome.items += sum(item.run.expected.values())
        outcome.recordings[item.name] = recording
        wrong = (judge or problems)(item, recording)
        if wrong:
            outcome.failures[item.name] = wrong
    outcome.seconds = time.perf_counter() - begin
    return outcome


def runner(playback: Callable[[AcceleratorConfig], Playback], watchdog: int = 20_000) -> Callable[..., Outcome]:
    """A suite's function `run_plan(config, plan, folder, *, waves, progress)`, which calls `run_plan` with the playback of the
    configuration."""
    def run(
        config: AcceleratorConfig, plan: Sequence[Planned], folder: Path, *, waves: Waves | None = None, progress: bool = False,
    ) -> Outcome:
        return run_plan(playback(config), plan, folder, waves=waves, progress=progress, watchdog=watchdog)
    return run


def problems(item: Planned, recording: Recording) -> list[str]:
    """Descriptions of everything that is wrong with a recording; empty when all results and rates are as required."""
    found = list(recording.errors)
    for port, wanted in item.expected.items():
        found += _differences(port, recording.outputs[port], wanted)
    for name, value in item.observed.items():
        if recording.observed[name] != value:
            found.append(f"{name} is {recording.observed[name]}, not {value}")
    for port, least in item.least_rate.items():
        if rate(recording, port) < least:
            found.append(f"{port}: {rate(recording, port):.3f} items a cycle, fewer than {least}")
    if item.most_cycles is not None and recording.cycles > item.most_cycles:
        found.append(f"{recording.cycles} cycles, more than {item.most_cycles}")
    return found


def _differences(port: str, got: np.ndarray, wanted: np.ndarray) -> list[str]:
    found = [f"{port}: {len(got)} items, not {len(wanted)}"] if len(got) != len(wanted) else []
    shared = min(len(got), len(wanted))
    wrong = np.flatnonzero(got[:shared] != wanted[:shared])
    found += [f"{port} {i}: {got[i]}, golden {wanted[i]}" for i in wrong[:_SHOWN]]
    if len(wrong) > _SHOWN:
        found.append(f"{port}: and {len(wrong) - _SHOWN} more items")
    return found
