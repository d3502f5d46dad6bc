"""What happens in a unit while its quick suite is played, counted by Verilator: bits that change, and ways taken at choices."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from msv2.cases.mutants.targets import Target
from rtl.emit import keeping_sources
from tb.common import exact
from tb.common.emission import forget_emitted
from tb.common.playback import Playback
from tb.common.player import Recording, Run, play
from tb.common.runner import COUNTS

_MANGLED = re.compile(r"__0([0-9A-Fa-f]{2})")
_BENCH = re.compile(r"(?:.*\.)?(?:tb|memory_model|beat_memory|\w+_(?:bench|device|with_memory))")
"""Modules of testbenches: the one around everything, memories, and what holds a unit with its surroundings."""


@dataclass(frozen=True)
class Point:
    """A thing that Verilator counts.

    Attributes:
        kind: "toggle", "branch" or "line".
        module: the module that it is in.
        line, column: the place in the Verilog.
        what: the signal, bit and direction of a change; or the way at a choice.
        count: how often it happened.
    """

    kind: str
    module: str
    line: int
    column: int
    what: str
    count: int


def counted(target: Target, folder: Path) -> tuple[list[Point], str]:
    """Plays a unit's quick suite. Returns what was counted, but for units inside that have a target of their own, and the
    unit's Verilog, in which attributes `src` name lines of Python.

    Raises:
        RuntimeError: the suite fails.
    """
    played: list[Playback] = []

    def counting(playback: Playback, runs: Sequence[Run], folder: Path, **options: object) -> list[Recording]:
        played.append(playback)
        return play(playback, runs, folder, counted=True, **options)

    forget_emitted()
    try:
        with keeping_sources(in_verilog=True), exact.played_by(counting):
            outcome = target.suite.run_plan(target.config, target.plan(), folder)
            (verilog,) = {dict(playback.design().sources)["dut.v"] for playback in played}
    finally:
        forget_emitted()
    if outcome.failures:
        raise RuntimeError(f"{target.name}: {next(iter(outcome.failures.items()))}")
    with open(folder / COUNTS, errors="replace") as lines:
        found = list(points(lines))
    return [point for point in found if not any(f".{name}" in f".{point.module}." for name in target.apart)], verilog


def points(lines: Iterable[str]) -> Iterator[Point]:
    """What Verilator's file says of modules that are not the testbench's."""
    for line in lines:
        if not line.startswith("C '"):
            continue
        words, _, count = line[3:].rpartition("'")
        fields = dict(part.split("\2", 1) for part in words.split("\1") if "\2" in part)
        module = fields["page"].partition("/")[2]
        if not _BENCH.fullmatch(module):
            yield Point(fields["t"], module, int(fields["l"]), int(fields["n"]), _plain(fields["o"]), int(count))


def _plain(name: str) -> str:
    """A name in Verilog from that in the simulator."""
    return _MANGLED.sub(lambda code: chr(int(code[1], 16)), name.replace("___05F", "__"))
