"""Proofs by induction over time, with the SAT solver of Yosys.

A property is a signal that must never be 1. The base of a proof begins in any state, with a reset; its step begins in any
state. The reset is free afterwards, as all inputs are.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from amaranth.back import rtlil
from amaranth.hdl import Elaboratable, Signal

from synth.flow import run

_PASSES = ("hierarchy -top top", "proc", "flatten", "opt -full", "memory_collect", "opt_clean", "memory_map", "opt -full",
           "async2sync", "dffunmap", "setundef -zero", "opt -full", "simplemap", "opt -full")


class Circuit:
    """A circuit for proofs, whose intermediate files lie in a folder.

    Args:
        circuit: the circuit; its clock domain is `sync`.
        inputs: its inputs.
        bad: the signals that must never be 1, by name.
        folder: the folder; Yosys' log is `yosys.log` in it.
    """

    def __init__(self, circuit: Elaboratable, inputs: Sequence[Signal], bad: dict[str, Signal], folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        source, self._log = folder / "circuit.il", folder / "yosys.log"
        source.write_text(rtlil.convert(circuit, name="top", ports=[*inputs, *bad.values()], emit_src=False))
        self._design = run(f"read_rtlil {source}", *_PASSES, log=self._log)
        self._bad = {name: signal.name for name, signal in bad.items()}

    def fails(self, cycles: int, *names: str) -> bool:
        """Whether one of these signals, or without names one of all, can be 1 within so many cycles after a reset."""
        return self._found(f"-seq {cycles + 1} -set-at 1 rst 1 -prove-skip 1 " + self._never(names or self._bad))

    def inductive(self, cycles: int) -> bool:
        """Whether all signals are 0 in a cycle if they were 0 in so many cycles before it."""
        before = " ".join(f"-set-at {i + 1} {signal} 0" for i in range(cycles) for signal in self._bad.values())
        return not self._found(f"-seq {cycles + 1} {before} -prove-skip {cycles} " + self._never(self._bad))

    def _never(self, names: Iterable[str]) -> str:
        return " ".join(f"-prove {self._bad[name]} 0" for name in names)

    def _found(self, arguments: str) -> bool:
        """Whether the solver finds a trace that contradicts what is to be proven. AssertionError if it says neither."""
        begin = self._log.stat().st_size
        run("cd top", f"sat {arguments}", "cd ..", log=self._log, design=self._design)
        said = self._log.read_text()[begin:]
        found, none = "model found: FAIL" in said, "no model found: SUCCESS" in said
        assert found != none, said[-500:]
        return found
