"""Decides with ABC whether an output of a circuit can ever become 1, by property directed reachability or up to a depth."""

from __future__ import annotations

import re
import subprocess
import time
from dataclasses import dataclass

from msv2.cases.formal.circuit import Circuit, find_abc

SIMPLIFY = "strash; scleanup; dc2; scorr; dc2"
"""Before a proof: the logic is made smaller and registers that are proven to be equal become one. Both are sound, because all
registers of the file begin with 0: an undefined one is an input in the first cycle."""

LARGE = 60_000
"""AND gates from which on `scorr` would take longer than the proof."""


@dataclass(frozen=True)
class Verdict:
    """What is known of an output.

    Attributes:
        kind: "proven" (it is 0 for ever), "fails" (it becomes 1), or "open".
        depth: cycles from reset to the 1 of "fails", or in which "open" is known to stay 0.
        seconds: processor time.
    """

    kind: str
    depth: int
    seconds: float


def _abc(circuit: Circuit, output: str, commands: str, limit: float) -> tuple[str, float]:
    """What ABC says after commands on the cone of one output, and the seconds that it took."""
    begin = time.perf_counter()
    script = f"&r {circuit.path.name}; &cone -O {circuit.outputs[output]}; &put; {commands}"
    try:
        run = subprocess.run([str(find_abc()), "-c", script], capture_output=True, text=True, cwd=circuit.path.parent,
                             timeout=limit, check=False)
        said = run.stdout + run.stderr
    except subprocess.TimeoutExpired as stopped:
        said = (stopped.stdout or b"").decode()
    return said, time.perf_counter() - begin


def reach(circuit: Circuit, output: str, seconds: float) -> Verdict:
    """Looks for the first cycle in which the output is 1, for so many seconds."""
    said, took = _abc(circuit, output, f"strash; scleanup; dc2; bmc3 -v -T {max(1, round(seconds))}", 3 * seconds + 60)
    failed = re.search(r"asserted in frame (\d+)", said)
    if failed:
        return Verdict("fails", int(failed[1]), took)
    frames = [int(n) for n in re.findall(r"(?m)^ *(\d+) [+:]", said)]
    return Verdict("open", max(frames, default=-1) + 1, took)


def prove(circuit: Circuit, output: str, seconds: float) -> Verdict:
    """Proves that the output is always 0, or finds how it becomes 1, or says up to which cycle it stays 0."""
    simplify = SIMPLIFY if circuit.ands < LARGE else "strash; scleanup; dc2"
    said, took = _abc(circuit, output, f"{simplify}; print_stats; pdr -T {max(1, round(seconds))}", 4 * seconds + 120)
    failed = re.search(r"asserted in frame (\d+)", said)
    if failed:
        return Verdict("fails", int(failed[1]), took)
    if "Property proved" in said:
        return Verdict("proven", 0, took)
    if re.search(r"lat = +0 +and = +0 ", said):
        # Simplification left a constant. It is 0 unless the output is 1 in the first cycle.
        first, more = _abc(circuit, output, "strash; bmc3 -F 2", 60)
        return Verdict("fails" if "asserted in frame" in first else "proven", 0, took + more)
    rest = reach(circuit, output, seconds / 2)
    return Verdict(rest.kind, rest.depth, took + rest.seconds)
