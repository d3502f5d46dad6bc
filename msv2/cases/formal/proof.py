"""Proofs of units: what is built, what is claimed of it, and the verdicts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from amaranth.lib import wiring

from msv2.cases.formal.bench import Bench
from msv2.cases.formal.circuit import text_of, to_circuit
from msv2.cases.formal.contract import general
from msv2.cases.formal.engine import Verdict, prove, reach
from spec.config import TINY, TINY_V3

SMALL = TINY.with_(row_width=32, line_buffer_bytes=64, sort_buffer_bytes=256, splat_cache_lines=4)
"""A machine with frames of 2 x 2 tiles, chunks of 16 intersections and a line buffer of 8."""

SMALL_SUPER = TINY_V3.with_(
    row_width=128, line_buffer_bytes=64, sort_buffer_bytes=256, list_heads=8, header_lines=4, batch_places=16)
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


@dataclass(frozen=True)
class Posed:
    """A bench as text: what a proof is about, in every detail.

    Attributes:
        text: RTLIL.
        claims: names of the claims; claim n has the outputs bad_n and canary_n.
    """

    text: str
    claims: tuple[str, ...]


def posed(proof: Proof) -> Posed:
    """The bench of a proof as text."""
    bench = proof.bench()
    signals = {signal.name: signal for claim in bench.claims for signal in (claim.bad, claim.canary)}
    return Posed(text_of(bench.finish(), bench.inputs, signals), tuple(claim.name for claim in bench.claims))


def judge(proof: Proof, folder: Path, question: Posed | None = None) -> Iterator[Judged]:
    """Judges all claims of a proof, one after the other.

    Args:
        folder: for files, in a folder of the proof's name.
        question: what `posed` returned, where it is known.
    """
    question = question or posed(proof)
    numbers = range(len(question.claims))
    names = [f"{kind}_{n}" for n in numbers for kind in ("bad", "canary")]
    circuit = to_circuit(question.text, names, folder / proof.folder_name)
    for number, name in zip(numbers, question.claims, strict=True):
        canary = reach(circuit, f"canary_{number}", max(proof.seconds, CANARY_SECONDS))
        verdict = prove(circuit, f"bad_{number}", proof.seconds)
        yield Judged(proof.name, name, circuit.latches, circuit.ands, verdict, canary)
