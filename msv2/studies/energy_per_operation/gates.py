"""Plays a run of a unit's test bench (`tb.common.player.Run`) on its mapped netlist, with the same streams and comparison.

All outputs are compared up to the point where the run is left. Only a window of the run is counted, and only its cycles are
simulated with delays.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from spec.packing import pack, unpack
from synth.power.simulate import Counts, Simulation
from tb.common.playback import Playback, Stream
from tb.common.player import Run

RESET = 8
"""Number of reset cycles before a run."""

_SHOWN = 3


@dataclass(frozen=True)
class Window:
    """The cycles that are counted.

    Attributes:
        warm: the number of cycles before the window, from the first cycle on in which an item is offered.
        cycles: the length of the window.
        whole: whether the run goes on to its end after the window; otherwise it is left there.
    """

    warm: int
    cycles: int
    whole: bool = False


@dataclass(frozen=True)
class Played:
    """The results of a run.

    Attributes:
        outputs: the rows of every output stream, up to where the run was left.
        counts: the transitions counted in the window.
        moved: the number of items that each stream moved in the window, and the increase of each counter.
        cycles: the length of the run.
        errors: descriptions of problems other than wrong rows.
    """

    outputs: dict[str, np.ndarray]
    counts: Counts
    moved: dict[str, int]
    cycles: int
    errors: tuple[str, ...]


class _Source:
    """Offers rows, each until it is taken. After `answer` was called, it offers a row only when its request is due."""

    def __init__(self, simulation: Simulation, stream: Stream, rows: np.ndarray):
        self._simulation, self._name = simulation, stream.name
        patterns = pack(stream.record, rows)
        self._bits = np.unpackbits(patterns, axis=1, bitorder="little", count=stream.record.width)
        self.moved, self._due, self._asked = 0, None, deque()

    @property
    def left(self) -> int:
        return len(self._bits) - self.moved

    def answer(self) -> None:
        self._due = 0

    def asked(self, cycle: int) -> None:
        self._asked.append(cycle)

    def offer(self, cycle: int) -> None:
        if self._due is not None:
            while self._asked and self._asked[0] <= cycle:
                self._asked.popleft()
                self._due += 1
        self._offers = self.left > 0 and self._due != 0
        self._simulation.set(f"{self._name}__valid", int(self._offers))
        if self._offers:
            self._simulation.set(f"{self._name}__payload", self._bits[self.moved])

    def look(self) -> bool:
        moves = bool(self._offers and self._simulation.get(f"{self._name}__ready")[0])
        self.moved += moves
        if moves and self._due is not None:
            self._due -= 1
        return moves


class _Sink:
    """Takes everything that comes."""

    def __init__(self, simulation: Simulation, stream: Stream):
        self._simulation, self._stream, self._taken = simulation, stream, []

    @property
    def moved(self) -> int:
        return len(self._taken)

    def look(self) -> bool:
        moves = bool(self._simulation.get(f"{self._stream.name}__valid")[0])
        if moves:
            self._taken.append(self._simulation.get(f"{self._stream.name}__payload").copy())
        return moves

    def rows(self) -> np.ndarray:
        record = self._stream.record
        bits = np.array(self._taken, np.uint8).reshape(-1, record.width)
        return unpack(record, np.packbits(bits, axis=1, bitorder="little"))


def start(simulation: Simulation, playback: Playback, run: Run, constants: Mapping[str, int], strobe: str | None) -> None:
    """Applies settings and constants, a reset, and a strobe after it. Settings for which the unit has no port are left out."""
    values = {name: 0 for name in simulation.flat.inputs if name != "clk" and not name.startswith("memory")}
    values |= {name: int(run.settings.get(name, 0)) for name, _ in playback.settings if name in values}
    values |= {f"{stream.name}__ready": 1 for stream in playback.outputs} | dict(constants) | {"rst": 1}
    simulation.timed = False
    for name, value in values.items():
        simulation.set(name, value)
    for cycle in range(RESET):
        if cycle == RESET - 2:
            simulation.set("rst", 0)
        if strobe and cycle == RESET - 1:
            simulation.set(strobe, 1)
        simulation.settle()
        simulation.edge()
    if strobe:
        simulation.set(strobe, 0)


def play(
    simulation: Simulation, playback: Playback, run: Run, window: Window, *, answers: Mapping[str, str] | None = None,
    counters: tuple[str, ...] = (), watchdog: int = 20_000,
) -> Played:
    """Plays a run without pauses. `start` must have been called.

    Args:
        simulation: the simulation of the unit.
        playback, run: the unit's test bench, and the run to play.
        window: the cycles that are counted.
        answers: input streams that answer an output stream of requests, `run.settings["delay"]` + 1 cycles later.
        counters: plain outputs that count operations.
        watchdog: the run is given up after this many cycles in which no item moves.
    """
    sources = {stream.name: _Source(simulation, stream, run.inputs[stream.name]) for stream in playback.inputs}
    sinks = {stream.name: _Sink(simulation, stream) for stream in playback.outputs}
    ports = {**sources, **sinks}
    asked = {reads: sources[data] for data, reads in (answers or {}).items()}
    for source in asked.values():
        source.answer()

    def progress() -> dict[str, int]:
        return {name: port.moved for name, port in ports.items()} | {name: simulation.number(name) for name in counters}

    cycle = quiet = 0
    before, moved, counts = {}, {}, None
    while quiet < watchdog:
        if cycle == window.warm:
            before = progress()
            simulation.forget()
            simulation.timed = True
        if cycle == window.warm + window.cycles:
            counts, moved = simulation.counts(), {name: n - before[name] for name, n in progress().items()}
            simulation.timed = False
            if not window.whole:
                break
        for source in sources.values():
            source.offer(cycle)
        simulation.settle()
        busy = False
        for name, port in ports.items():
            if port.look():
                busy = True
                if name in asked:
                    asked[name].asked(cycle + int(run.settings["delay"]) + 1)
        simulation.edge()
        quiet, cycle = 0 if busy else quiet + 1, cycle + 1
        if window.whole and counts is not None and all(sinks[name].moved >= n for name, n in run.expected.items()):
            break
    simulation.settle()
    errors = [f"{wrong} gates have not settled"] if (wrong := simulation.check()) else []
    if counts is None:
        raise ValueError(f"run {run.name} must last {window.warm + window.cycles} cycles, not {cycle!r}")
    return Played({name: sink.rows() for name, sink in sinks.items()}, counts, moved, cycle, tuple(errors))


def problems(expected: Mapping[str, np.ndarray], played: Played, *, whole: bool) -> list[str]:
    """Descriptions of everything that is wrong; empty when every bit is right. A run that was left is compared up to there."""
    found = list(played.errors)
    for port, wanted in expected.items():
        got = played.outputs[port]
        if len(got) > len(wanted) or (whole and len(got) != len(wanted)):
            found.append(f"{port}: {len(got)} items, not {len(wanted)}")
        shared = min(len(got), len(wanted))
        wrong = np.flatnonzero(got[:shared] != wanted[:shared])
        found += [f"{port} {i}: {got[i]}, golden {wanted[i]}" for i in wrong[:_SHOWN]]
        if len(wrong) > _SHOWN:
            found.append(f"{port}: and {len(wrong) - _SHOWN} more items")
    return found
