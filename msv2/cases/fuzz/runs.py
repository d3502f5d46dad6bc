"""Runs cases in a worker process, which is killed and started again where a case takes too long or kills it."""

from __future__ import annotations

import json
import os
import selectors
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any

from msv2.cases.fuzz.samples import FORMATS
from msv2.cases.fuzz.worker import FAILED, OUTCOMES
from spec.paths import ROOT

SECONDS = 60.0
"""Wall time that a case may take. On a computer without other work they take milliseconds, and those with a reader in a process
of its own half a second."""

STEP = 1000
"""Cases after which `run_cases` gives an account."""


@dataclass
class Tally:
    """What the cases of a format did.

    Attributes:
        outcomes: how many cases there were, by `msv2.cases.fuzz.worker.OUTCOMES`.
        failures: of each failed case `index`, `what`, `where` and `trace`.
        seconds: what the cases took. slowest: the longest of them.
    """

    outcomes: dict[str, int] = field(default_factory=lambda: dict.fromkeys(OUTCOMES, 0))
    failures: list[dict[str, Any]] = field(default_factory=list)
    seconds: float = 0.0
    slowest: float = 0.0

    @property
    def cases(self) -> int:
        """The number of cases."""
        return sum(self.outcomes.values())


class Worker:
    """The worker process, started when it is needed. Use it as a context manager."""

    def __init__(self, seconds: float = SECONDS) -> None:
        self._seconds, self._process = seconds, None

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop()

    def run(self, name: str, seed: int, index: int) -> dict[str, Any]:
        """The worker's answer to a case; a failure where it hangs or dies. A new worker first loads the good sample."""
        if self._process is None:
            self._start()
            if index:
                self._ask(name, seed, 0)
        return self._ask(name, seed, index)

    def _start(self) -> None:
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(entry or os.getcwd() for entry in sys.path)}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "msv2.cases.fuzz.worker"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env=environment, cwd=ROOT)

    def _ask(self, name: str, seed: int, index: int) -> dict[str, Any]:
        process = self._process
        assert process is not None and process.stdin is not None and process.stdout is not None
        try:
            process.stdin.write(json.dumps({"format": name, "seed": seed, "index": index}) + "\n")
            process.stdin.flush()
        except BrokenPipeError:
            return self._lost("the process died between two cases")
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            if not selector.select(self._seconds if index else None):  # the good sample may wait for compilers
                return self._lost(f"took more than {self._seconds:g} s")
        line = process.stdout.readline()
        if not line:
            return self._lost(f"the process died (status {process.wait()})")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _lost(self, what: str) -> dict[str, Any]:
        self._stop()
        return {"outcome": FAILED, "what": what, "where": "?", "trace": ""}

    def _stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


def missing(name: str) -> list[str]:
    """The packages that a format needs and that are not installed."""
    return [package for package in FORMATS[name].needs if find_spec(package) is None]


def shares(names: list[str], cases: int) -> dict[str, int]:
    """How many of the cases each format gets: at least the good sample and one more."""
    whole = sum(FORMATS[name].share for name in names)
    return {name: max(2, round(cases * FORMATS[name].share / whole)) for name in names}


def run_cases(
    counts: dict[str, int], seed: int, *, seconds: float = SECONDS, tick: Callable[[], object] = lambda: None,
    before: Mapping[str, Tally] | None = None,
) -> Iterator[tuple[str, Tally]]:
    """Runs the cases of each format, and yields its name and what they did so far after every STEP of them and at the end.

    Args:
        counts: the number of cases by format; the first case of each is the good sample.
        seed: selects the other cases.
        seconds: the limit for a case.
        tick: called after every case.
        before: what the first cases of formats did in an earlier run of this seed; they are not run again.
    """
    for name, count in counts.items():
        tally = (before or {}).get(name) or Tally()
        if tally.cases >= count:
            continue
        with Worker(seconds) as worker:
            for index in range(tally.cases, count):
                if index % STEP == 0 and tally.cases:
                    yield name, tally
                begin = time.perf_counter()
                answer = worker.run(name, seed, index)
                took = time.perf_counter() - begin
                tally.outcomes[answer["outcome"]] += 1
                tally.seconds, tally.slowest = tally.seconds + took, max(tally.slowest, took if index else 0.0)
                if answer["outcome"] == FAILED or (index == 0 and answer["outcome"] != OUTCOMES[0]):
                    what = answer.get("what", "the good sample is refused")
                    tally.failures.append({"index": index, "what": what, "where": answer.get("where", "?"),
                                           "trace": answer.get("trace", "")})
                tick()
        yield name, tally
