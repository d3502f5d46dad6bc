"""Proofs of units: what is built, what is claimed of it, and the verdicts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from amaranth.lib import wiring

from msv2.cases.formal.bench import Bench
from msv2.cases.formal.circuit import to_circuit
from msv2.cases.formal.contract import general
from msv2.cases.formal.engine import Verdict, prove, reach
from spec.config import TINY, TINY_V3

SMALL = TINY.with_(row_width=32, line_buffer_bytes=64, sort_buffer_bytes=256, splat_cache_lines=4)
"""A machine with frames of 2 x 2 tiles, chunks of 16 intersections and a line buffer of 8."""

SMALL_SUPER = TINY_V3.with_(row_width=128, line_buffer_bytes=64, sort_buffer_bytes=256)
"""The same with lists by super-tile, of which a frame has 2 x 2."""

CANARY_SECONDS = 15.0


@dataclass(frozen=True)
class Proof:
    """Claims of one unit at one set of parameters.

    Attributes:
        unit: the component's class.
        make: builds the component.
        claims: functions that make claims on a bench; the general ones are in `contract`.
        at: the parameters in words, where they matter.
        world: arguments of `Bench`.
        seconds: time limit of each claim.
        quick: it takes a second or two, so the quick tests run it.
    """

    unit: type[wiring.Component]
    make: Callable[[], wiring.Component]
    claims: tuple[Callable[[Bench], object], ...] = (general,)
    at: str = ""
    world: Mapping[str, Any] = field(default_factory=dict)
    seconds: float = 15.0
    quick: bool = False

    @property
    def name(self) -> str:
        """The unit's name, and its parameters where there are several proofs of it."""
        return f"{self.unit.__name__} ({self.at})" if self.at else self.unit.__name__

    @property
    def folder_name(self) -> str:
        """The name in letters, digits and underscores."""
        return "".join(letter if letter.isalnum() else "_" for letter in self.name)

    def bench(self) -> Bench:
        """The bench with all claims."""
        bench = Bench(self.make(), **self.world)
        for claim in self.claims:
            claim(bench)
        return bench


@dataclass(frozen=True)
class Judged:
    """A claim with what became of it.

    Attributes:
        unit, claim: names.
        latches, ands: size of the whole circuit of the unit and its bench.
        verdict: of the claim.
        canary: of the canary, which has to fail.
    """

    unit: str
    claim: str
    latches: int
    ands: int
    verdict: Verdict
    canary: Verdict

    @property
    def result(self) -> str:
        """"proven", "fails", "open", or "empty" where a proven claim speaks of nothing that was seen to happen."""
        return "empty" if self.verdict.kind == "proven" and self.canary.kind != "fails" else self.verdict.kind


def judge(proof: Proof, folder: Path, *, seconds: float | None = None) -> Iterator[Judged]:
    """Judges all claims of a proof, one after the other; `seconds` replaces the proof's time limit of a claim."""
    bench = proof.bench()
    signals = {signal.name: signal for claim in bench.claims for signal in (claim.bad, claim.canary)}
    circuit = to_circuit(bench.finish(), bench.inputs, signals, folder / proof.folder_name)
    limit = proof.seconds if seconds is None else seconds
    for claim in bench.claims:
        canary = reach(circuit, claim.canary.name, max(limit, CANARY_SECONDS))
        verdict = prove(circuit, claim.bad.name, limit)
        yield Judged(proof.name, claim.name, circuit.latches, circuit.ands, verdict, canary)
