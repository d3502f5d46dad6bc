"""Plays a unit's quick suite on mutants of the unit: one build for all of them, and one short run of the simulator for each."""

from __future__ import annotations

import json
import math
import shutil
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from msv2.cases.mutants import mutate
from msv2.cases.mutants.mutate import Mutant
from msv2.cases.mutants.targets import Target
from rtl.emit import keeping_sources
from tb.common import exact
from tb.common.emission import forget_emitted
from tb.common.exact import Planned
from tb.common.playback import ERRORS, Playback
from tb.common.player import Recording, Run, prepare, recording_of
from tb.common.runner import simulate

SURVIVED = "survived"

SLACK, SECONDS = 5, 10
"""A mutant may take SLACK times the sound circuit's processor time, and SECONDS more."""


class _Captured(Exception):
    """Leaves a suite that is about to play its plan."""

    def __init__(self, playback: Playback, runs: Sequence[Run], watchdog: int):
        super().__init__("the plan was not played")
        self.playback, self.runs, self.watchdog = playback, runs, watchdog


@dataclass(frozen=True)
class Bench:
    """A unit's suite, and the unit as a circuit.

    Attributes:
        target: the unit.
        plan: its runs.
        playback: the unit with a file at each stream.
        module, text: the circuit's top module, and its RTLIL with attributes `src`.
        watchdog: cycles without an item after which a run is given up.
    """

    target: Target
    plan: Sequence[Planned]
    playback: Playback
    module: str
    text: str
    watchdog: int

    @property
    def scope(self) -> tuple[str, ...]:
        """The names of the instances from the testbench to the circuit."""
        return ("dut",) if self.playback.module == self.module else ("dut", "unit")


@dataclass(frozen=True)
class Verdict:
    """What became of a mutant.

    Attributes:
        result: SURVIVED, or how it was killed: "difference", "hang", "no end" or "crash".
        run: the run that killed it. words: the first thing that was wrong.
    """

    result: str
    run: str = ""
    words: str = ""


def bench_of(target: Target, folder: Path) -> Bench:
    """The bench of a unit; nothing is simulated."""
    forget_emitted()
    plan = target.plan()
    with keeping_sources() as texts, exact.played_by(_capture):
        try:
            target.suite.run_plan(target.config, plan, folder)
        except _Captured as found:
            playback, watchdog = found.playback, min(found.watchdog, target.watchdog)
    module = playback.module if playback.module in texts else playback.module.removesuffix("_with_memory")
    return Bench(target, plan, playback, module, texts[module], watchdog)


def _capture(playback: Playback, runs: Sequence[Run], folder: Path, *, watchdog: int, **options: object) -> list[Recording]:
    raise _Captured(playback, runs, watchdog)


class Player:
    """Plays mutants of a bench.

    Parameters:
        bench: the bench.
        mutants: all mutants of the circuit.
        folder: for files; `msv2.cases.mutants.mutate.draw` was called with it.

    Raises:
        RuntimeError: the suite does not pass on the circuit without a fault.
    """

    def __init__(self, bench: Bench, mutants: Sequence[Mutant], folder: Path):
        verilog = mutate.verilog_with(mutants, bench.text, bench.module, bench.playback.verilog, folder)
        self._bench, self._folder = bench, (folder / "play").resolve()
        self._playback = replace(bench.playback, name=f"mutants-{bench.target.name}", verilog=verilog)
        shutil.rmtree(self._folder, ignore_errors=True)
        (self._folder / "mutants").mkdir(parents=True)
        self._orders = prepare(self._playback, [item.run for item in bench.plan], self._folder, bench.watchdog)
        self._orders |= {"scope": bench.scope, "seconds": 1800}
        sound = self._simulate([0])[0]
        if "died" in sound:
            raise RuntimeError(f"{bench.target.name}: the simulation of the sound circuit died with {sound['died']}")
        wrong = self._judge(0, sound)
        if wrong.result != SURVIVED:
            raise RuntimeError(f"{bench.target.name}: the sound circuit fails in {wrong.run}: {wrong.words}")
        self.seconds = sound["cpu"]
        self._orders["seconds"] = math.ceil(SLACK * self.seconds + SECONDS)

    def play(self, numbers: Sequence[int], tick: Callable[[int], object] = lambda number: None) -> dict[int, Verdict]:
        """The verdicts of some mutants, by number. Their files are deleted."""
        verdicts = {}
        for insist in (False, True):
            rest = [number for number in numbers if number not in verdicts]
            found = self._simulate(rest, rest if insist else ())
            for number, report in found.items():
                verdict = self._judge(number, report)
                if insist or verdict.result != SURVIVED or not report["runs"]:
                    verdicts[number] = verdict
                    tick(number)
        for number in numbers:
            shutil.rmtree(self._folder / "mutants" / str(number), ignore_errors=True)
        return verdicts

    def _simulate(self, numbers: Sequence[int], insist: Sequence[int] = ()) -> dict[int, dict]:
        """The reports of mutants. A mutant that only has another timing in some runs, or outputs that the suite may accept, is
        told from others when it is played again with `insist`."""
        if not numbers:
            return {}
        orders = {**self._orders, "mutants": list(numbers), "insist": list(insist)}
        (self._folder / "orders.json").write_text(json.dumps(orders))
        simulate(self._playback.design(), "msv2.cases.mutants.forks", self._folder,
                 env={"PLAYBACK_FOLDER": str(self._folder)}, plusargs=[f"+folder={self._folder}", "+verilator+noassert"])
        return {number: json.loads((self._folder / "mutants" / f"{number}.json").read_text()) for number in numbers}

    def _judge(self, number: int, report: dict) -> Verdict:
        """What the suite says of the runs that a mutant changed."""
        if "died" in report:
            too_long = -report["died"] in (signal.SIGXCPU, signal.SIGKILL, signal.SIGXFSZ)
            return Verdict("no end" if too_long else "crash", words=f"the simulation died with {report['died']}")
        runs = sorted(map(int, report["runs"]))
        place = self._folder / "mutants" / str(number)

        def played(playback: Playback, chosen: Sequence[Run], folder: Path, **options: object) -> list[Recording]:
            return [recording_of(playback, run, report["runs"][str(n)], place / str(n))
                    for n, run in zip(runs, chosen, strict=True)]

        try:
            with exact.played_by(played):
                outcome = self._bench.target.suite.run_plan(
                    self._bench.target.config, [self._bench.plan[n] for n in runs], self._folder)
        except Exception as error:  # a suite may refuse outputs that no sound unit gives
            return Verdict("difference", self._bench.plan[runs[0]].name, f"{type(error).__name__}: {error}"[:200])
        if not outcome.failures:
            return Verdict(SURVIVED)
        run, wrong = next(iter(outcome.failures.items()))
        return Verdict("hang" if ERRORS[2] in wrong else "difference", run, str(wrong[0])[:200])
